// What skipping costs, as the detector itself sees it: a share of the skipped frames is looked at afterwards.

import { useEffect, useState } from "preact/hooks";
import { every, json } from "../shared/api";
import { count, duration, percent } from "../shared/format";
import { Section } from "../shared/parts";
import { counters, opened } from "./store";
import type { AuditFigures, AuditGroup, AuditRate, CameraStates } from "./types";

/** Time between two looks at the groups, milliseconds. */
const LOOK_MS = 5000;

/** `91.2 % (88.0 to 93.6)`: never without its interval. */
export function rate(found: AuditRate | null | undefined): string {
  if (!found) return "–";
  const end = (share: number) => (100 * share).toFixed(1);
  return `${percent(found.rate)} (${end(found.low)} to ${end(found.high)})`;
}

/** The figures of a camera with their groups; nothing while there are none. */
function useFigures(camera: string | undefined): AuditFigures | undefined {
  const [found, setFound] = useState<AuditFigures | undefined>(undefined);
  useEffect(() => {
    setFound(undefined);
    if (camera === undefined) return;
    const stop = new AbortController();
    void every(LOOK_MS, stop.signal, async () => {
      const states = await json<CameraStates>(`/api/v1/cameras/${encodeURIComponent(camera)}/frame-states`, { signal: stop.signal });
      setFound(states.audit ?? undefined);
    });
    return () => stop.abort();
  }, [camera]);
  return found;
}

export function Audit() {
  const camera = opened.value;
  const figures = useFigures(camera);
  const lately = counters.value.get(camera ?? "")?.audit;
  if (!figures || !lately) return null;
  const { all } = lately;
  return (
    <Section
      id="audit"
      title="What skipping costs"
      wide
      aside={
        <span>
          recall <b id="audit-recall">{rate(all.recall)}</b> · precision <b id="audit-precision">{rate(all.precision)}</b>
        </span>
      }
    >
      <p class="message quiet">
        Against the detector, not against the truth: {count(lately.drawn)} skipped frames were drawn at random and looked at by the
        detector after they were answered ({count(lately.missed)} of them it had no time for). <b>Recall</b> is the share of its boxes
        that had been shown, <b>precision</b> the share of the shown boxes that it confirms; in brackets between what they lie at 95 %.
        A policy that keeps showing an object which the detector misses loses precision here, although it may be right. It cost{" "}
        {count(lately.calls)} calls and {duration(lately.detector_s)} of the detector, which are in no other figure of this page but the
        power.
      </p>
      {all.frames === 0 ? (
        <p class="message quiet">Nothing has been compared yet.</p>
      ) : (
        <div class="scroll" tabIndex={0} role="group" aria-label="table of the audit">
          <table>
            <thead>
              <tr>
                <th scope="col" class="left">of</th>
                <th scope="col">frames</th>
                <th scope="col">detector's boxes</th>
                <th scope="col">recall</th>
                <th scope="col">shown boxes</th>
                <th scope="col">precision</th>
                <th scope="col">overlap of pairs</th>
                <th scope="col">newly appeared</th>
                <th scope="col">gone or missed</th>
              </tr>
            </thead>
            <tbody>
              <Row group={figures.all} what="all" />
              {figures.by_state?.map((group) => <Row key={group.name} group={group} what={`state ${group.name}`} />)}
              {figures.by_pause?.map((group) => <Row key={group.name} group={group} what={`frame ${group.name} of a pause`} />)}
              {figures.by_size?.map((group) => <Row key={group.name} group={group} what={`${group.name} boxes`} />)}
            </tbody>
          </table>
        </div>
      )}
    </Section>
  );
}

function Row({ group, what }: { group: AuditGroup; what: string }) {
  return (
    <tr>
      <td class="left">{what}</td>
      <td>{group.frames ? count(group.frames) : "–"}</td>
      <td>{count(group.detected)}</td>
      <td>{rate(group.recall)}</td>
      <td>{count(group.shown)}</td>
      <td>{rate(group.precision)}</td>
      <td>{group.mean_overlap?.toFixed(2) ?? "–"}</td>
      <td>{count(group.appeared)}</td>
      <td>{count(group.gone)}</td>
    </tr>
  );
}
