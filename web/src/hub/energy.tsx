// Energy and skip rate of the fleet over time.

import { useEffect, useMemo, useState } from "preact/hooks";
import type uPlot from "uplot";
import { json, messageOf } from "../shared/api";
import { Chart } from "../shared/chart";
import { dateTime, joules, percent, plural } from "../shared/format";
import { Quality, Section } from "../shared/parts";
import { EnergyTable } from "./node";
import { Fault, useLoaded } from "./parts";
import { refine, route } from "./route";
import type { Energy, EnergyGroup } from "./types";

export interface Span {
  id: string;
  words: string;
  /** Length of a point, milliseconds. */
  step: number;
  points: number;
}

const HOUR = 3_600_000;
const SPANS: Span[] = [
  { id: "hour", words: "last hour", step: HOUR / 12, points: 12 },
  { id: "day", words: "last 24 hours", step: HOUR, points: 24 },
  { id: "month", words: "last 30 days", step: 24 * HOUR, points: 30 },
];

/** Beginnings of the points. Only completed points are shown: an incomplete one would look like a drop. Days are in UTC, as in the hub. */
export function beginnings(span: Span, now: number): number[] {
  const last = (Math.floor(now / span.step) - 1) * span.step;
  return Array.from({ length: span.points }, (_, index) => last - (span.points - 1 - index) * span.step);
}

type Point = { at: number } & Found;
type Found = { groups: EnergyGroup[]; audit?: Energy["audit"] };

/** One answer for each point, four requests at a time. Older points are read once. */
function usePoints(span: Span): { points: Point[]; fault: string } {
  const [points, setPoints] = useState<Point[]>([]);
  const [fault, setFault] = useState("");
  useEffect(() => {
    const stop = new AbortController();
    const known = new Map<number, Found>();
    const look = async () => {
      const times = beginnings(span, Date.now());
      const last = times.at(-1)!;
      // Reports may arrive late, so the last two points are read again.
      const missing = times.filter((at) => !known.has(at) || at >= last - span.step);
      const work = async () => {
        for (let at = missing.pop(); at !== undefined; at = missing.pop()) {
          const found = await json<Energy>(`/api/v1/energy?by=all&since_ms=${at}&until_ms=${at + span.step}`, { signal: stop.signal });
          known.set(at, found);
        }
      };
      try {
        await Promise.all([work(), work(), work(), work()]);
        setPoints(times.map((at) => ({ at, groups: known.get(at)?.groups ?? [], audit: known.get(at)?.audit })));
        setFault("");
      } catch (error) {
        if (!stop.signal.aborted) setFault(messageOf(error));
      }
    };
    void look();
    const timer = setInterval(() => {
      if (!document.hidden) void look();
    }, 30_000);
    return () => {
      clearInterval(timer);
      stop.abort();
    };
  }, [span.id]);
  return { points, fault };
}

export function EnergyView() {
  const span = SPANS.find((span) => span.id === route.value.query.get("span")) ?? SPANS[0]!;
  const { points, fault } = usePoints(span);
  const since = points[0]?.at;
  const by = useLoaded<Energy>(since === undefined ? undefined : `/api/v1/energy?by=threshold&since_ms=${since}`, 30_000);
  const qualities = useMemo(() => {
    const all = new Set<string>(points.flatMap((point) => point.groups.filter((group) => group.quality !== "unavailable").map((group) => group.quality)));
    return ["measured", "partial", "estimated"].filter((quality) => all.has(quality));
  }, [points]);
  const times = points.map((point) => point.at / 1000);
  const skip = useMemo(
    (): uPlot.AlignedData => [
      times,
      points.map(({ groups }) => {
        const avoided = groups.reduce((sum, group) => sum + group.avoided_calls, 0);
        const frames = groups.reduce((sum, group) => sum + group.frames, 0);
        return frames ? avoided / frames : null;
      }),
    ],
    [points],
  );
  const recall = useMemo((): uPlot.AlignedData => {
    const of = (end: "low" | "rate" | "high") => points.map(({ audit }) => audit?.recall?.[end] ?? null);
    return [times, of("rate"), of("low"), of("high")];
  }, [points]);
  return (
    <>
      <Section
        id="energy"
        title="Energy over time"
        wide
        aside={
          <div class="row" role="group" aria-label="Span">
            {SPANS.map((one) => (
              <button key={one.id} type="button" class="plain" aria-pressed={one.id === span.id} onClick={() => refine({ span: one.id })}>
                {one.words}
              </button>
            ))}
          </div>
        }
      >
        <Fault text={fault} />
        {points.length > 0 && qualities.length === 0 && <SoFar span={span} energy={by.value} />}
        {qualities.map((quality) => (
          <Energies key={quality} quality={quality} points={points} />
        ))}
      </Section>
      <Section id="skip" title="Skip rate over time" wide>
        {points.length > 0 && qualities.length === 0 && <p class="message quiet">The chart begins with that of energy.</p>}
        {qualities.length > 0 && (
          <Chart
            data={skip}
            label={`Share of frames that skipped the detector, ${span.words}`}
            lines={[{ label: "frames that skipped the detector", colour: "--state-p" }]}
            value={(value) => percent(value, 0)}
            range={[0, 1]}
            sync="energy"
          />
        )}
      </Section>
      {points.some(({ audit }) => audit?.recall) && (
        <Section id="recall" title="Recall against the detector over time" wide aside={<span class="quiet">against the detector, not the truth</span>}>
          <Chart
            data={recall}
            label={`Share of the detector's boxes on audited skipped frames that had been shown, ${span.words}`}
            lines={[
              { label: "recall against the detector", colour: "--state-p" },
              { label: "from (95 %)", colour: "--quiet", dash: [6, 4] },
              { label: "to", colour: "--quiet", dash: [6, 4] },
            ]}
            value={(value) => percent(value, 0)}
            range={[0, 1]}
            sync="energy"
          />
        </Section>
      )}
      <Section id="by-threshold" title={`By policy and value, ${span.words}`} wide>
        <Fault text={by.fault} />
        <EnergyTable energy={by.value} />
      </Section>
    </>
  );
}

/** The energy of reports that no completed point of the chart has. */
function SoFar({ span, energy }: { span: Span; energy: Energy | undefined }) {
  const groups = (energy?.groups ?? []).filter(({ quality }) => quality !== "unavailable");
  if (groups.length === 0) return <p class="message quiet">No clip with energy in this period.</p>;
  const first = (Math.floor(Date.now() / span.step) + 1) * span.step;
  return (
    <p class="message">
      So far{" "}
      {["measured", "partial", "estimated"].map((quality) => {
        const of = groups.filter((group) => group.quality === quality);
        if (of.length === 0) return null;
        const [used, clips] = [of.reduce((sum, group) => sum + group.joules, 0), of.reduce((sum, group) => sum + group.clips, 0)];
        return (
          <span key={quality}>
            <b>{joules(used)}</b> in {plural(clips, "clip")} <Quality quality={quality} />{" "}
          </span>
        );
      })}
      . The first point of the chart appears at {dateTime(first)}; each has {span.id === "hour" ? "five minutes" : span.id === "day" ? "an hour" : "a day (UTC)"}.
    </p>
  );
}

function Energies({ quality, points }: { quality: string; points: Point[] }) {
  const data = useMemo((): uPlot.AlignedData => {
    const of = (figure: (group: EnergyGroup) => number) =>
      points.map(({ groups }) => {
        const group = groups.find((group) => group.quality === quality);
        return group ? figure(group) : null;
      });
    return [points.map((point) => point.at / 1000), of((group) => group.joules), of((group) => group.joules + group.saved_joules_estimated)];
  }, [points, quality]);
  return (
    <div class="energy-chart">
      <Quality quality={quality} />
      <Chart
        data={data}
        label={`Energy of the fleet over time, ${quality}, and the same plus the energy that avoided calls saved`}
        lines={[
          { label: "energy used", colour: "--state-i" },
          { label: "≈ plus energy saved by avoided calls (estimated)", colour: "--quiet", dash: [6, 4] },
        ]}
        value={joules}
        range={[0, null]}
        sync="energy"
      />
    </div>
  );
}
