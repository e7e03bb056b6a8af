// What skipping costs against the detector, which runs afterwards on a random share of the skipped frames.

import { count, duration, percent, plural } from "../shared/format";
import { Section } from "../shared/parts";
import { counters, opened } from "./store";
import type { AuditRate } from "./types";

/** `91.2 % (88.0 to 93.6)`: never without its interval. */
export function rate(found: AuditRate | null | undefined): string {
  if (!found) return "–";
  const end = (share: number) => (100 * share).toFixed(1);
  return `${percent(found.rate)} (${end(found.low)} to ${end(found.high)})`;
}

export function Audit() {
  const figures = counters.value.get(opened.value ?? "")?.audit;
  if (!figures?.drawn) return null;
  return (
    <Section
      id="audit"
      title="What skipping costs"
      wide
      aside={
        <span>
          recall <b id="audit-recall">{rate(figures.recall)}</b> · precision <b id="audit-precision">{rate(figures.precision)}</b>
        </span>
      }
    >
      <p class="message quiet">
        The detector is the reference here, not the truth: {plural(figures.drawn, "skipped frame")} were drawn at random and given to the
        detector after they were answered. It had no time for {count(figures.missed)} of them; the 95 % confidence intervals in brackets
        allow for any result on those. <b>Recall</b> is the share of its {plural(figures.detected, "box", "boxes")} that had been shown;{" "}
        <b>precision</b> is the share of the {count(figures.shown)} shown boxes that it confirms. Keeping an object that the detector
        misses lowers precision here, even if the object is real. The audit used {plural(figures.calls, "extra detector call")} (
        {duration(figures.detector_s)}). Only the power figure includes them.
      </p>
    </Section>
  );
}
