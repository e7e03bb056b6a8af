import { describe as group, expect, test } from "vitest";
import { FrameLog, describe, percentile, skipped, why, type Seen } from "../src/node/frames";
import { avoided, saved } from "../src/node/energy";
import type { ClipReport, Detections } from "../src/node/types";

function frame(seq: number, state: Detections["state"], more: Partial<Detections> & { u?: number } = {}): Seen {
  return {
    v: 1, seq, at: seq / 10, t_ns: seq * 1e8, clip: "c", state, width: 640, height: 480, boxes: [],
    latency_ms: { total: 1, waiting: 0, policy: 0 }, ...more,
  } as Seen;
}

group("why the detector ran", () => {
  test("is told from the frame's own figures", () => {
    expect(why(frame(1, "I", { tau_max: 5e-4, u: 3e-4 }), "u")).toContain("uncertain: τ 5.0×10⁻⁴ ≥ u 3.0×10⁻⁴");
    expect(why(frame(1, "AI", { tau_max: 3e-4, u: 3e-4 }), "u")).toContain("uncertain");
    expect(why(frame(1, "I", { tau_max: 1e-4, u: 3e-4 }), "u")).toContain("a cap or an audit");
    expect(why(frame(1, "I", { u: 3e-4 }), "u")).toBe("no object was followed yet");
    expect(why(frame(1, "E+I", { tau_max: 5e-4, u: 3e-4 }), "u")).toBe("the screen saw something");
  });

  test("is not made up for another policy, nor for frames that skipped it", () => {
    expect(why(frame(1, "I", { tau_max: 5e-4 }), "lambda")).toBe("the policy asked for it");
    expect(why(frame(1, "P", { tau_max: 1e-4, u: 3e-4 }), "u")).toBe("");
  });

  test("a degraded frame is no skipped one", () => {
    const degraded = frame(1, "P", { degraded: true, tau_max: 5e-4, u: 3e-4 });
    expect(skipped(degraded)).toBe(false);
    expect(skipped(frame(1, "P"))).toBe(true);
    expect(why(degraded, "u")).toContain("could not be had");
    expect(describe(degraded, "u", 1)).toContain("P, degraded");
  });
});

group("the log of frames", () => {
  test("keeps the newest, however many come", () => {
    const log = new FrameLog(100);
    for (let seq = 0; seq < 10_000; seq += 1) log.push(frame(seq, "P"));
    expect(log.length).toBeLessThanOrEqual(164);
    expect(log.length).toBeGreaterThanOrEqual(100);
    expect(log.came).toBe(10_000);
    expect(log.bySeq(9_999)?.seq).toBe(9_999);
    expect(log.bySeq(0)).toBeUndefined();
    expect(log.at(log.indexOf(9_950))?.seq).toBe(9_950);
    expect(log.last(3).map((kept) => kept.seq)).toEqual([9_997, 9_998, 9_999]);
  });

  test("knows the newer of two frames with one number", () => {
    const log = new FrameLog(10);
    log.push(frame(1, "P"));
    log.push(frame(1, "I"));
    expect(log.bySeq(1)?.state).toBe("I");
    expect(log.indexOf(1)).toBe(1);
  });
});

test("percentiles are values that were there", () => {
  expect(percentile([], 0.5)).toBeUndefined();
  expect(percentile([7], 0.99)).toBe(7);
  const values = Array.from({ length: 100 }, (_, index) => 100 - index);
  expect(percentile(values, 0.5)).toBe(50);
  expect(percentile(values, 0.99)).toBe(99);
});

function clip(quality: string, joules: number | undefined, more: Partial<ClipReport> = {}): ClipReport {
  return {
    states: { E: 10, P: 50, "E+I": 0, I: 40, AI: 0 }, degraded_frames: 5, duration_s: 10,
    detector_latency_ms: { count: 40, mean: 20, p50: 20, p95: 20, p99: 20 },
    energy: { quality, joules, coverage: 1, source: "x", total_from: "x", samples: 1, domains: [] },
    ...more,
  } as unknown as ClipReport;
}

group("what was saved", () => {
  test("degraded frames are not among the avoided calls", () => {
    expect(avoided(clip("measured", 100))).toBe(55);
  });

  test("an avoided call is priced at the clip's own power and detector time", () => {
    const [sum] = saved([clip("measured", 100)]);
    // 10 W for 20 ms, 55 times.
    expect(sum?.vanilla).toBeCloseTo(100 + 55 * 0.2, 9);
  });

  test("measured and estimated are never added", () => {
    const sums = saved([clip("measured", 100), clip("estimated", 50), clip("measured", 1)]);
    expect(sums.map((sum) => [sum.quality, sum.joules])).toEqual([["measured", 101], ["estimated", 50]]);
  });

  test("joules of a part of the time are left out, and calls without a price are named", () => {
    const part = clip("partial", 100);
    part.energy.coverage = 0.9;
    expect(saved([part, clip("unavailable", undefined)])).toEqual([]);
    const none = clip("measured", 100, { detector_latency_ms: { count: 0, mean: 0, p50: 0, p95: 0, p99: 0 } });
    expect(saved([none])[0]).toMatchObject({ vanilla: 100, unpriced: 55 });
  });
});
