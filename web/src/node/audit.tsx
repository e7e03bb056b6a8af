// What skipping costs against the detector, which runs afterwards on a random share of the skipped frames.

import { count, duration, percent } from "../shared/format";
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
  if (!figures) return null;
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
        Against the detector, not against the truth: {count(figures.drawn)} skipped frames were drawn at random and the detector ran on
        them after they were answered. {count(figures.missed)} of them it had no time for: the intervals in brackets (95 %) allow for any
        result on those. <b>Recall</b> is the share of its {count(figures.detected)} boxes that had been shown, <b>precision</b> the share
        of the {count(figures.shown)} shown boxes that it confirms. A policy that keeps showing an object which the detector misses loses
        precision here, although it may be right. It cost {count(figures.calls)} calls and {duration(figures.detector_s)} of the detector,
        which are in no other figure of this page but the power.
      </p>
    </Section>
  );
}
