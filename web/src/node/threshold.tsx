// The threshold slider: on a logarithmic scale over its useful range, in force from the next frame on.

import { useEffect, useState } from "preact/hooks";
import { every, json, messageOf, pause, send } from "../shared/api";
import { duration, parsed, percent, small, typed } from "../shared/format";
import { Quality, Section, whyNot } from "../shared/parts";
import { cameras, counters, thresholdSpec, thresholdInForce, lost, opened, overview, thresholds } from "./store";
import type { ThresholdSpec, SkipEstimates } from "./types";

const STEPS = 200;
/** The values of the paper's threshold sweep. */
const PAPER = [3e-4, 5e-4, 7e-4, 1e-3];

/** The range of the slider: the useful values of the policy. The text field accepts the whole range. */
export function usefulRange(spec: Pick<ThresholdSpec, "useful_minimum" | "useful_maximum">): [number, number] {
  return [spec.useful_minimum, spec.useful_maximum];
}

export function toSlider(value: number, [low, high]: [number, number]): number {
  const place = (STEPS * Math.log(value / low)) / Math.log(high / low);
  return Math.round(Math.min(STEPS, Math.max(0, place)));
}

export function fromSlider(place: number, [low, high]: [number, number]): number {
  return Number((low * (high / low) ** (place / STEPS)).toPrecision(3));
}

/** What is wrong with a text as a value of the threshold; undefined if it may be set. */
export function outside(text: string, spec: Pick<ThresholdSpec, "name" | "minimum" | "maximum">): string | undefined {
  const value = parsed(text);
  const range = `${spec.name} is a number from ${typed(spec.minimum)} to ${typed(spec.maximum)}.`;
  if (value === undefined) return `${text.trim() === "" ? "Nothing was entered" : `“${text.trim()}” is not a number`}: ${range}`;
  if (value < spec.minimum) return `${typed(value)} is too small: ${range}`;
  return value > spec.maximum ? `${typed(value)} is too large: ${range}` : undefined;
}

/** Time between two requests for the skip rates of other values, milliseconds. */
const ESTIMATE_MS = 5000;
const BEFORE_MS = 1000;

/** Share of frames that a value would have skipped, between the values that the node computed. */
export function estimated(curve: readonly { value: number; skip_rate: number }[], value: number): number | undefined {
  const first = curve[0];
  const last = curve.at(-1);
  if (!first || !last || !(value > 0)) return undefined;
  if (value <= first.value) return first.skip_rate;
  if (value >= last.value) return last.skip_rate;
  const next = curve.findIndex((point) => point.value >= value);
  const [low, high] = [curve[next - 1]!, curve[next]!];
  const share = Math.log(value / low.value) / Math.log(high.value / low.value);
  return low.skip_rate + share * (high.skip_rate - low.skip_rate);
}

/** The skip rates of other values over the last minutes, computed by the node. */
function useEstimates(camera: string | undefined, name: string | undefined): SkipEstimates | undefined {
  const [found, setFound] = useState<SkipEstimates | undefined>(undefined);
  useEffect(() => {
    setFound(undefined);
    if (camera === undefined || name !== "u") return;
    const stop = new AbortController();
    // What the node has recorded begins with the first frames under this threshold.
    void pause(BEFORE_MS, stop.signal).then(() => every(ESTIMATE_MS, stop.signal, async () => {
      // A camera without frames has no recording: the node would return an error.
      if (lost.value !== undefined || !counters.value.get(camera)?.frames) return;
      setFound(await json<SkipEstimates>(`/api/v1/cameras/${encodeURIComponent(camera)}/skip-estimate`, { signal: stop.signal }));
    }));
    return () => stop.abort();
  }, [camera, name]);
  return found;
}

export function ThresholdPanel() {
  const about = thresholdSpec.value;
  const inForce = thresholdInForce.value;
  const [text, setText] = useState("");
  const [edited, setEdited] = useState(false);
  const [everywhere, setEverywhere] = useState(false);
  const [said, setSaid] = useState<{ good: boolean; text: string } | undefined>(undefined);

  useEffect(() => {
    if (!edited && inForce !== undefined) setText(typed(inForce));
  }, [inForce, edited, opened.value]);

  const estimates = useEstimates(opened.value, about?.name);

  if (!about) {
    return (
      <Section id="threshold" title="Threshold">
        <p class="message quiet">The policy {overview.value?.policy ?? ""} has no threshold.</p>
      </Section>
    );
  }
  const range = usefulRange(about);
  const value = parsed(text);
  const change = (next: string) => {
    setText(next);
    setEdited(true);
    setSaid(undefined);
  };
  const submit = async (event: Event) => {
    event.preventDefault();
    const wrong = outside(text, about);
    if (wrong !== undefined) return setSaid({ good: false, text: wrong });
    const path = everywhere ? "/api/v1/threshold" : `/api/v1/cameras/${encodeURIComponent(opened.value!)}/threshold`;
    try {
      await send("PUT", path, { [about.name]: value });
      setSaid({ good: true, text: `${about.name} = ${small(value)} from the next frame on.` });
      setEdited(false);
    } catch (error) {
      const refused = messageOf(error);
      setSaid({ good: false, text: refused });
    }
  };
  const changed = value !== undefined && inForce !== undefined && value !== inForce;
  const paper = about.name === "u" ? PAPER.filter((mark) => mark >= range[0] && mark <= range[1]) : [];
  const forbidden = whyNot();
  const camera = cameras.value.find((camera) => camera.camera === opened.value);
  const advice = camera?.advice;
  return (
    <Section
      id="threshold"
      title={`Threshold ${about.name}`}
      aside={<span>in force: <b id="in-force">{small(inForce)}</b></span>}
    >
      <form onSubmit={submit}>
        <p class="message quiet">{about.meaning.replace(/\.?$/, ".")}</p>
        <div class="slider">
          <input
            type="range"
            min={0}
            max={STEPS}
            step={1}
            aria-label={`${about.name}, on a logarithmic scale`}
            aria-valuetext={text}
            value={value !== undefined && value > 0 ? toSlider(value, range) : 0}
            onInput={(event) => change(typed(fromSlider(Number(event.currentTarget.value), range)))}
          />
          <span class="ends quiet">
            <span>{small(range[0])}: accurate</span>
            <span>{small(range[1])}: saves most</span>
          </span>
        </div>
        {estimates && value !== undefined && value > 0 && (
          <p class="message" id="would-skip">
            At {small(value)}, <b>≈ {percent(estimated(estimates.values, value), 0)}</b> of the last {duration(estimates.duration_s)} would
            have skipped the detector{" "}
            <span class="quiet">
              (it was {percent(estimates.skip_rate, 0)}). <Quality quality="estimated" /> Tracking would have differed too.
            </span>
          </p>
        )}
        <div class="row">
          <label for="u">{about.name}</label>
          <input
            id="u"
            type="text"
            inputmode="decimal"
            autocomplete="off"
            value={text}
            aria-describedby="threshold-range threshold-message"
            aria-invalid={said && !said.good ? true : undefined}
            onInput={(event) => change(event.currentTarget.value)}
          />
          <button disabled={forbidden !== undefined}>Set</button>
          {cameras.value.length > 1 && (
            <label>
              <input type="checkbox" checked={everywhere} onChange={(event) => setEverywhere(event.currentTarget.checked)} />{" "}
              all {cameras.value.length} cameras
            </label>
          )}
          {edited && changed && (
            <button
              type="button"
              class="plain"
              onClick={() => {
                setEdited(false);
                setSaid(undefined);
              }}
            >
              Leave at {small(inForce)}
            </button>
          )}
        </div>
        {advice && (
          <p id="threshold-advice" class="row">
            <span>
              No frame of {advice.frames} was skipped, although objects were tracked in {advice.followed} of them. Try{" "}
            </span>
            <button type="button" class="plain" onClick={() => change(typed(advice.try))}>
              {small(advice.try, 1)}
            </button>
          </p>
        )}
        {paper.length > 0 && (
          <p class="row marks">
            <span class="quiet">in the paper:</span>
            {paper.map((mark) => (
              <button key={mark} type="button" class="plain" onClick={() => change(typed(mark))}>
                {small(mark, 1)}
              </button>
            ))}
          </p>
        )}
        <p id="threshold-message" class={`message ${said?.good ? "good" : "bad"}`} role="alert">
          {forbidden ?? said?.text ?? ""}
        </p>
        <p id="threshold-range" class="message quiet">
          Range {small(about.minimum)} to {small(about.maximum)}, default {small(about.default)}.{" "}
          {camera?.u_as_published &&
            `Equivalent in the published code at ${camera.width}x${camera.height}: ${small(camera.u_as_published, 3)}. `}
          {thresholds.value?.survives_restart
            ? "A change survives a restart."
            : "A change is lost at a restart: no state_dir is set."}
        </p>
      </form>
    </Section>
  );
}
