// How uncertainty, power, detector time and rates went.

import { useMemo } from "preact/hooks";
import type uPlot from "uplot";
import { knobValue } from "../shared/knob";
import { Chart } from "../shared/chart";
import { milliseconds, percent, small, watts } from "../shared/format";
import { Quality, Section } from "../shared/parts";
import { percentile } from "./frames";
import { clips, counters, knob, log, opened, pointed, power, samples, tick } from "./store";

/** Frames that the chart of uncertainties shows. */
const FRAMES = 600;

type Column = (number | null)[];

/** τ_max of the last frames against the threshold they were decided with. */
export function Uncertainty() {
  const now = tick.value;
  const name = knob.value?.name ?? "u";
  const frames = useMemo(() => log.last(FRAMES), [now, opened.value]);
  const data = useMemo((): uPlot.AlignedData => {
    const taus: Column = frames.map((frame) => (frame.tau_max && frame.tau_max > 0 ? frame.tau_max : null));
    const limits: Column = frames.map((frame) => knobValue(frame, name) ?? null);
    return [frames.map((frame) => frame.at), taus, limits];
  }, [frames]);
  // Another policy's knob is no bound on uncertainty.
  const comparable = name === "u";
  const shown = comparable ? data : ([data[0], data[1]] as uPlot.AlignedData);
  return (
    <Section id="uncertainty" title="Uncertainty against the threshold" aside={<span class="quiet">logarithmic, no unit</span>}>
      <div
        onClick={() => {
          if (under.index !== null) pointed.value = frames[under.index]?.seq;
        }}
      >
        <Chart
          key={String(comparable)}
          data={shown}
          label="Largest uncertainty of each of the last frames, and the threshold. The detector runs where the first reaches the second."
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

/** Power by domain since this page was opened. */
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
      aside={message ? <Quality quality={message.power_quality} /> : undefined}
    >
      {domains.length ? (
        <Chart
          key={domains.join()}
          data={data}
          label={`Power by domain since this page was opened, ${message!.power_quality}`}
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
  const figures: [string, number | undefined][] = [
    ["p50", percentile(times, 0.5)],
    ["p99", percentile(times, 0.99)],
  ];
  return (
    <Section id="detector" title="Detector time" aside={<span class="quiet">last {times.length} calls seen here</span>}>
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
    </Section>
  );
}

/** Skip rate and frames a second since this page was opened, and before that by the clips that the node remembers. */
export function Rates() {
  const now = tick.value;
  const camera = opened.value ?? "";
  const data = useMemo((): { skip: uPlot.AlignedData; rate: uPlot.AlignedData } => {
    const times: number[] = [];
    const skip: Column = [];
    const rate: Column = [];
    const list = samples.get(camera) ?? [];
    const begin = list[0]?.at ?? Infinity;
    // Older clips first, each at its middle.
    for (const clip of clips.value.filter((clip) => clip.camera === camera).reverse()) {
      const middle = clip.started_ns / 1e9 + clip.duration_s / 2;
      if (middle >= begin || middle <= (times.at(-1) ?? 0)) continue;
      times.push(middle);
      skip.push(clip.skip_rate);
      rate.push(clip.duration_s > 0 ? clip.frames / clip.duration_s : null);
    }
    // Over ten seconds each, so that a single frame does not show as a jump.
    let from = 0;
    list.forEach((sample, index) => {
      while (list[from]!.at < sample.at - 10) from += 1;
      const before = list[from]!;
      if (index === 0 || sample.at - before.at < 3) return;
      const frames = sample.frames - before.frames;
      times.push(sample.at);
      skip.push(frames ? (sample.skipped - before.skipped) / frames : null);
      rate.push(frames / (sample.at - before.at));
    });
    return { skip: [times, skip], rate: [times, rate] };
  }, [now, camera, clips.value]);
  return (
    <Section id="rates" title="Skip rate and frame rate" aside={<span class="quiet">by clip, and by ten seconds since this page was opened</span>}>
      <Chart
        data={data.skip}
        label="Share of frames that skipped the detector, over time"
        lines={[{ label: "frames that skipped the detector", colour: "--state-p" }]}
        value={(value) => percent(value, 0)}
        range={[0, 1]}
        height={130}
        sync="rates"
      />
      <Chart
        data={data.rate}
        label="Frames a second, over time"
        lines={[{ label: "frames a second", colour: "--state-e" }]}
        value={(value) => value.toFixed(1)}
        range={[0, null]}
        height={110}
        sync="rates"
      />
    </Section>
  );
}
