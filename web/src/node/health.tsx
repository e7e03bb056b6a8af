// Health part by part, frames that were not processed, and what waits for a hub.

import { count, duration, plural } from "../shared/format";
import { Pill, Section } from "../shared/parts";
import { counters, opened, overview } from "./store";

const DROPPED: Record<string, string> = {
  lost: "lost on the way",
  overrun: "pushed out by a newer one",
  late: "too late",
  stray: "of another stream",
  duplicate: "there twice",
  undecodable: "not to be decoded",
  oversized: "too large",
  unknown_format: "of an unknown format",
  stopped: "left at the stop",
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
        <ul class="reasons">
          {now.reasons.map((reason) => (
            <li key={`${reason.part} ${reason.subject ?? ""}`}>
              <Pill mood="bad">{reason.effect === "not_ready" ? "not ready" : "degraded"}</Pill> <b>{reason.part}</b>
              {reason.subject ? ` ${reason.subject}` : ""}: {reason.reason}
              <span class="quiet"> for {duration(reason.since_s)}</span>
            </li>
          ))}
        </ul>
      )}
      <dl class="pairs">
        <dt>model</dt>
        <dd>{now.model}</dd>
        <dt>runs on</dt>
        <dd>
          {now.provider ?? "nothing yet"} (asked for: {now.requested_providers.join(", ")})
        </dd>
        <dt>power figures</dt>
        <dd>{now.energy.source}</dd>
        <dt>reports for a hub</dt>
        <dd>
          {count(now.outbox.waiting)} waiting, {count(now.outbox.lost)} lost;{" "}
          {now.outbox.durable ? "kept on disk" : "in memory only"}
        </dd>
        <dt>frames not processed</dt>
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
