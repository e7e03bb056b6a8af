import { describe as group, expect, test } from "vitest";
import { CAUSES, FrameLog, describe, past, percentile, skipped, why, type Seen } from "../src/node/frames";
import type { CameraHistory, Detections } from "../src/node/types";

const U = { name: "u", value: 3e-4 };

function frame(seq: number, state: Detections["state"], more: Partial<Detections> = {}): Seen {
  return {
    v: 1, seq, at: seq / 10, t_ns: seq * 1e8, clip: "c", state, width: 640, height: 480, boxes: [],
    latency_ms: { total: 1, waiting: 0, policy: 0 }, ...more,
  } as Seen;
}

group("why the detector ran", () => {
  test("is what the node says, with the figures where they tell more", () => {
    expect(why(frame(1, "I", { cause: "uncertain", tau_max: 5e-4, threshold: U }))).toBe("an object became too uncertain: τ 5.0×10⁻⁴ ≥ u 3.0×10⁻⁴");
    expect(why(frame(1, "I", { cause: "periodic_cap", tau_max: 1e-4, threshold: U }))).toBe(CAUSES.periodic_cap.meaning);
    expect(why(frame(1, "E+I", { cause: "audit", threshold: U }))).toContain("checks the screen");
    expect(why(frame(1, "I", { cause: "expected_loss", tau_max: 5e-4, threshold: { name: "lambda", value: 0.3 } }))).toBe(CAUSES.expected_loss.meaning);
  });

  test("is not made up for a node that does not say it, nor for frames that skipped it", () => {
    expect(why(frame(1, "I", { tau_max: 5e-4, threshold: U }))).toBe("the policy asked for it");
    expect(why(frame(1, "P", { tau_max: 1e-4, threshold: U }))).toBe("");
    expect(why(frame(1, "I", { cause: "of_a_later_version" as never }))).toBe("of_a_later_version");
  });

  test("a degraded frame is no skipped one, and keeps its cause", () => {
    const degraded = frame(1, "P", { degraded: true, cause: "new_object", tau_max: 5e-4, threshold: U });
    expect(skipped(degraded)).toBe(false);
    expect(skipped(frame(1, "P"))).toBe(true);
    expect(why(degraded)).toContain("not available: a new object");
    expect(describe(degraded, 1)).toContain("P, degraded");
  });
});

group("the past", () => {
  const history = {
    camera: "front", now_ms: 0, slot_s: 10, slots: [], of_policy: 3,
    frames: {
      seq: [7, 8, 9], age_ms: [3000, 2000, 1000], state: ["I", "P", "P"], cause: ["uncertain", null, "uncertain"],
      degraded: [false, false, true], boxes: [2, 1, 0], tau_max: [5e-4, null, 4e-4], threshold: [3e-4, 3e-4, 3e-4],
      detector_ms: [20, null, null], total_ms: [22, 0.3, 0.4],
    },
  } as CameraHistory;

  test("is shown as frames of the same kind, with boxes that are counted and not shown", () => {
    const [first, second, third] = past(history, "u", 100);
    expect(describe(first!, 100)).toBe("frame 7 · 3.0 s ago · I, detector · an object became too uncertain: τ 5.0×10⁻⁴ ≥ u 3.0×10⁻⁴ · 2 boxes · 22.0 ms");
    expect(describe(second!, 100)).toBe("frame 8 · 2.0 s ago · P, predicted · 1 box · 0.3 ms");
    expect(second!.tau_max).toBeUndefined();
    expect(second!.latency_ms.detector).toBeUndefined();
    expect(skipped(third!)).toBe(false);
  });

  test("has the threshold of the policy in force only on the frames that it decided", () => {
    const frames = past({ ...history, of_policy: 1 }, "u", 100);
    expect(frames.map((frame) => frame.threshold?.name)).toEqual([undefined, undefined, "u"]);
  });

  test("comes before what was heard meanwhile, and no frame twice", () => {
    const log = new FrameLog(100);
    log.push(frame(9, "P"));
    log.push(frame(10, "I"));
    log.unshift(past(history, "u", 100));
    expect(log.last(10).map((kept) => kept.seq)).toEqual([7, 8, 9, 10]);
    expect(log.bySeq(9)?.pastBoxes).toBeUndefined();
    expect(log.indexOf(10)).toBe(3);
    const small = new FrameLog(2);
    small.push(frame(9, "P"));
    small.unshift(past(history, "u", 100));
    expect(small.last(10).map((kept) => kept.seq)).toEqual([8, 9]);
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

  test("puts the final answer of a pending frame where its first answer was", () => {
    const log = new FrameLog(10);
    log.push(frame(1, "P", { pending: true }));
    log.push(frame(2, "P"));
    expect(describe(log.at(0)!, 1)).toContain("predicted, detector at work");
    log.finish(frame(1, "I", { cause: "uncertain" }));
    log.finish(frame(7, "I"));
    expect(log.last(10).map((kept) => [kept.seq, kept.state, kept.pending])).toEqual([[1, "I", false], [2, "P", undefined]]);
    expect(log.newestFinal?.seq).toBe(1);
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
