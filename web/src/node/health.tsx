// Health by part, frames that were not processed, and reports that wait for a hub.

import { certificates, count, plural } from "../shared/format";
import { Section } from "../shared/parts";
import { counters, opened, overview } from "./store";

const DROPPED: Record<string, string> = {
  lost: "lost on the way",
  overrun: "replaced by a newer one",
  late: "out of order",
  stray: "from another stream",
  duplicate: "received twice",
  undecodable: "not decodable",
  oversized: "too large",
  unknown_format: "in an unknown format",
  stopped: "while the camera's loop was stopped",
};

export function Health() {
  const now = overview.value;
  if (!now) return null;
  const message = counters.value.get(opened.value ?? "");
  const dropped = Object.entries(message?.dropped ?? {}).filter(([, number]) => number > 0);
  return (
    <Section id="health" title="Health">
      {now.reasons.length === 0 ? (
        <p class="message good">Every part works.</p>
      ) : (
        <p class="message bad">{plural(now.reasons.length, "fault")}: the list is at the top of the page.</p>
      )}
      <dl class="pairs">
        <dt>model</dt>
        <dd>{now.model}</dd>
        <dt>runs on</dt>
        <dd>
          {now.provider ?? "nothing yet"} (requested: {now.requested_providers.join(", ")})
        </dd>
        <dt>power figures</dt>
        <dd>{now.power_source}</dd>
        <dt>reports for a hub</dt>
        <dd>
          {count(now.outbox.waiting)} waiting, {count(now.outbox.lost)} lost;{" "}
          {now.outbox.durable ? "kept on disk" : "in memory only"}
        </dd>
        {now.certificates.length > 0 && (
          <>
            <dt>certificates</dt>
            <dd>{certificates(now.certificates)}</dd>
          </>
        )}
        {(now.position.words !== "" || now.position.of_frames > 0) && (
          <>
            <dt>position</dt>
            <dd>
              {now.position.words ? `${now.position.source}: ${now.position.words}` : `from ${plural(now.position.of_frames, "frame")}`}
              {now.position.refused > 0 && <span class="bad">{`; ${count(now.position.refused)} could not be used`}</span>}
            </dd>
          </>
        )}
        <dt>dropped frames</dt>
        <dd>
          {dropped.length
            ? dropped.map(([kind, number]) => `${count(number)} ${DROPPED[kind] ?? kind}`).join(", ")
            : "none"}
          {message && message.degraded_frames > 0 && (
            <span class="bad">{`; ${plural(message.degraded_frames, "frame")} answered without the detector`}</span>
          )}
        </dd>
      </dl>
    </Section>
  );
}
