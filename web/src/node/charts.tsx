// Charts of uncertainty, power, detector time and rates.

import { useMemo } from "preact/hooks";
import type uPlot from "uplot";
import { Chart } from "../shared/chart";
import { milliseconds, percent, small, watts } from "../shared/format";
import { Quality, Section } from "../shared/parts";
import { percentile, type Seen } from "./frames";
import { whatIsMeasured } from "./header";
import { counters, hour, thresholdSpec, log, opened, overview, pointed, power, samples, tick } from "./store";

/** Length of an interval of the hour, seconds. */
const SLOT_S = 10;
/** Frames that the chart of uncertainties shows. */
const FRAMES = 600;

type Column = (number | null)[];

/** Longest pause between two frames that a line is drawn across, seconds. */
const LONGEST_PAUSE_S = 10;

/** Frames, with an empty entry in each long pause, so that the line has a gap there. */
export function withGaps<F extends { at: number }>(frames: readonly F[]): (F | { at: number })[] {
  return frames.flatMap((frame, index) => {
    const before = frames[index - 1];
    return before && frame.at - before.at > LONGEST_PAUSE_S ? [{ at: before.at + 1 }, frame] : [frame];
  });
}

function seqOf(frame: Seen | { at: number } | undefined): number | undefined {
  return frame && "seq" in frame ? frame.seq : undefined;
}

/** τ_max of the last frames against the threshold they were decided with. */
export function Uncertainty() {
  const now = tick.value;
  const name = thresholdSpec.value?.name;
  const frames = useMemo(() => log.last(FRAMES), [now, opened.value]);
  const shownFrames = useMemo(() => withGaps(frames), [frames]);
  const data = useMemo((): uPlot.AlignedData => {
    // The uncertainties of another policy, before a switch, are on another scale.
    const ours = shownFrames.map((frame) => ("seq" in frame && frame.threshold?.name === name ? frame : undefined));
    const taus: Column = ours.map((frame) => (frame?.tau_max && frame.tau_max > 0 ? frame.tau_max : null));
    const limits: Column = ours.map((frame) => frame?.threshold?.value || null);
    return [shownFrames.map((frame) => frame.at), taus, limits];
  }, [shownFrames, name]);
  // Another policy's threshold is not a limit on uncertainty.
  const comparable = name === undefined || name === "u";
  const shown = comparable ? data : ([data[0], data[1]] as uPlot.AlignedData);
  return (
    <Section id="uncertainty" title="Uncertainty against the threshold" aside={<span class="quiet">logarithmic, no unit</span>}>
      <div
        onClick={() => {
          if (under.index !== null) pointed.value = seqOf(shownFrames[under.index]);
        }}
      >
        <Chart
          key={String(comparable)}
          data={shown}
          label="Largest uncertainty of each of the last frames, and the threshold. The detector runs when the uncertainty reaches the threshold."
          lines={[
            { label: "largest τ of the frame", colour: "--state-i" },
            ...(comparable ? [{ label: "threshold u", colour: "--bad", dash: [6, 4], steps: true }] : []),
          ]}
          log
          value={small}
          height={180}
          onCursor={(index) => {
            under.index = index;
          }}
        />
      </div>
    </Section>
  );
}

const under: { index: number | null } = { index: null };

const DOMAINS: Record<string, { label: string; colour: string }> = {
  total: { label: "total", colour: "--text" },
  gpu: { label: "GPU", colour: "--state-i" },
  cpu: { label: "CPU", colour: "--state-ai" },
  io_mem: { label: "memory and I/O", colour: "--state-ei" },
};

/** Power by domain over the last hour; before this page was opened, in intervals of ten seconds. */
export function Power() {
  const now = tick.value;
  const message = counters.value.get(opened.value ?? "") ?? [...counters.value.values()][0];
  const domains = message?.watts.map((entry) => entry.domain) ?? [];
  const data = useMemo(
    (): uPlot.AlignedData => [
      power.map((sample) => sample.at),
      ...domains.map((domain): Column => power.map((sample) => sample.watts[domain] ?? null)),
    ],
    [now, domains.join()],
  );
  return (
    <Section
      id="power"
      title="Power"
      aside={message && <span class="quiet">of {whatIsMeasured(overview.value?.power_source)} <Quality quality={message.power_quality} /></span>}
    >
      {domains.length ? (
        <Chart
          key={domains.join()}
          data={data}
          label={`Power by domain over the last hour, ${message!.power_quality}`}
          lines={domains.map((domain) => DOMAINS[domain] ?? { label: domain, colour: "--state-e" })}
          value={watts}
          range={[0, null]}
          height={150}
        />
      ) : (
        <p class="message quiet">The node has no source of power figures.</p>
      )}
    </Section>
  );
}

/** How long the detector took, over the last frames where it ran. */
export function DetectorTime() {
  const now = tick.value;
  const times = useMemo(
    () => log.last(3000).map((frame) => frame.latency_ms.detector).filter((ms): ms is number => typeof ms === "number"),
    [now, opened.value],
  );
  const rest = useMemo(
    () => log.last(3000).filter((frame) => typeof frame.latency_ms.detector !== "number").map((frame) => frame.latency_ms.total),
    [now, opened.value],
  );
  const before = hour.value;
  const byTime = useMemo((): uPlot.AlignedData => {
    const times: number[] = [];
    const median: Column = [];
    const tail: Column = [];
    for (const slot of before) {
      times.push(slot.at_ms / 1000 + SLOT_S / 2);
      median.push(slot.detector_p50_ms ?? null);
      tail.push(slot.detector_p99_ms ?? null);
    }
    // After the node's intervals come those that this page computes from the frames it receives.
    const begin = before.length ? before.at(-1)!.at_ms / 1000 + SLOT_S : 0;
    const pieces = new Map<number, number[]>();
    for (const frame of log.last(6000)) {
      const ms = frame.latency_ms.detector;
      if (typeof ms !== "number" || frame.at < begin) continue;
      const piece = Math.floor((frame.at - begin) / SLOT_S);
      pieces.set(piece, [...(pieces.get(piece) ?? []), ms]);
    }
    for (const [piece, list] of [...pieces].sort(([a], [b]) => a - b)) {
      times.push(begin + piece * SLOT_S + SLOT_S / 2);
      median.push(percentile(list, 0.5) ?? null);
      tail.push(percentile(list, 0.99) ?? null);
    }
    return [times, median, tail];
  }, [Math.floor(now / 25), before, opened.value]);
  const figures: [string, number | undefined][] = [
    ["p50", percentile(times, 0.5)],
    ["p99", percentile(times, 0.99)],
  ];
  return (
    <Section id="detector" title="Detector time" aside={<span class="quiet">last {times.length} calls on this page</span>}>
      <dl class="figures">
        {figures.map(([label, value]) => (
          <div class="figure" key={label}>
            <dt>{label}, with queue and letterbox</dt>
            <dd>{milliseconds(value)}</dd>
          </div>
        ))}
        <div class="figure">
          <dt>p50 of a frame without the detector</dt>
          <dd>{milliseconds(percentile(rest, 0.5))}</dd>
        </div>
      </dl>
      <Chart
        data={byTime}
        label="Detector time over the last hour, median and 99th percentile per ten seconds"
        lines={[
          { label: "p50", colour: "--state-i" },
          { label: "p99", colour: "--state-ai", dash: [4, 3] },
        ]}
        value={milliseconds}
        range={[0, null]}
        height={110}
      />
    </Section>
  );
}

/** Skip rate and frames per second over the last hour, in the ten-second intervals that the node stores. */
export function Rates() {
  const now = tick.value;
  const camera = opened.value ?? "";
  const before = hour.value;
  const data = useMemo(() => {
    const times: number[] = [];
    const skip: Column = [];
    const rate: Column = [];
    const list = samples.get(camera) ?? [];
    const begin = list[0]?.at ?? Infinity;
    before.forEach((slot, index) => {
      const from = slot.at_ms / 1000;
      // An interval that has not ended when the page opens is shown from the frames that the page receives.
      if (from + SLOT_S > begin || (begin === Infinity && index === before.length - 1)) return;
      // A gap in time is a gap in the line.
      if (times.length && from - times.at(-1)! > 2 * SLOT_S) {
        times.push(from - 1);
        skip.push(null);
        rate.push(null);
      }
      times.push(from + SLOT_S / 2);
      skip.push(slot.frames ? slot.skipped / slot.frames : null);
      rate.push(slot.frames / SLOT_S);
    });
    // Over ten seconds each, so that a single frame does not show as a jump.
    let from = 0;
    list.forEach((sample, index) => {
      while (list[from]!.at < sample.at - SLOT_S) from += 1;
      const first = list[from]!;
      if (index === 0 || sample.at - first.at < 3) return;
      const frames = sample.frames - first.frames;
      times.push(sample.at);
      skip.push(frames ? (sample.skipped - first.skipped) / frames : null);
      rate.push(frames / (sample.at - first.at));
    });
    return { skip: [times, skip] as uPlot.AlignedData, rate: [times, rate] as uPlot.AlignedData };
  }, [now, camera, before]);
  return (
    <Section id="rates" title="Skip rate and frame rate" aside={<span class="quiet">over the last hour, per ten seconds</span>}>
      <Chart
        data={data.skip}
        label="Share of frames that skipped the detector, over the last hour"
        lines={[{ label: "frames that skipped the detector", colour: "--state-p" }]}
        value={(value) => percent(value, 0)}
        range={[0, 1]}
        height={130}
        sync="rates"
      />
      <Chart
        data={data.rate}
        label="Frames per second, over the last hour"
        lines={[{ label: "frames per second", colour: "--state-e" }]}
        value={(value) => value.toFixed(1)}
        range={[0, null]}
        height={110}
        sync="rates"
      />
    </Section>
  );
}
