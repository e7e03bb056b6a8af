// One line about the whole fleet.

import { count, interval, isClear, joules, percent, plural, short, shareOrInterval } from "../shared/format";
import { Figure, Pill, Quality } from "../shared/parts";
import { caller } from "../shared/api";
import { knowsSaved, Saved } from "./parts";
import { href, route } from "./route";
import { auditToday, byQuality, fleet, hubState, lost, readiness, today } from "./store";

const VIEWS: [string, string][] = [
  ["fleet", "Nodes"],
  ["energy", "Energy"],
  ["rollouts", "Rollouts"],
  ["trials", "Trials"],
  ["revisions", "Settings"],
  ["set-aside", "Set aside"],
];

export function Header() {
  const who = caller.value;
  const is = hubState({ lost: lost.value, isKnown: fleet.value !== undefined, readiness: readiness.value });
  const here = route.value.path[0] === "nodes" ? "fleet" : route.value.path[0];
  return (
    <header>
      <h1>
        <span class="quiet">albireo</span> fleet
      </h1>
      <span role="status">
        <Pill mood={is.mood}>{is.word}</Pill>
      </span>
      {is.faults.map(([part, reason]) => (
        <span key={part} class="why">
          <b>{part}</b> {reason}
        </span>
      ))}
      {lost.value !== undefined && <span class="why">{lost.value}. Reconnecting; the page shows the last data received.</span>}
      <nav aria-label="Views">
        {VIEWS.map(([view, words]) => (
          <a key={view} href={href([view])} aria-current={here === view ? "page" : undefined}>
            {words}
          </a>
        ))}
      </nav>
      <a class="docs" href="/docs/">
        /docs
      </a>
      {who && who.name !== "anonymous" && (
        <span class="quiet who">
          as {who.name}
          {who.may_tune ? "" : ", read-only"}
        </span>
      )}
    </header>
  );
}

export function Summary() {
  const known = fleet.value;
  const groups = byQuality(today.value ?? []);
  const avoided = groups.reduce((sum, group) => sum + group.avoided_calls, 0);
  const calls = groups.reduce((sum, group) => sum + group.detector_calls, 0);
  const audit = auditToday.value;
  const states = ["online", "degraded", "silent", "offline"] as const;
  return (
    <section class="wide headline" aria-label="Summary of the fleet">
      <dl class="figures">
        <Figure label="nodes">
          <span class="by-state">
            {states.map((state) => (
              <a key={state} href={href(["fleet"], { state })} class={known && known.counts[state] ? `state ${state}` : "state none"}>
                <b>{known ? count(known.counts[state] ?? 0) : "–"}</b> {state}
              </a>
            ))}
          </span>
        </Figure>
        <Figure label="detector calls avoided today (UTC)" note={avoided + calls ? `${short(avoided)} of ${short(avoided + calls)}` : "no clip yet"}>
          <span class="big">{avoided + calls ? percent(avoided / (avoided + calls)) : "–"}</span>
        </Figure>
        {groups.map((group) => (
          <Figure
            key={group.quality}
            label="energy today (UTC)"
            note={
              knowsSaved(group) ? (
                <>
                  avoided calls saved <Saved group={group} /> <Quality quality="estimated" />
                </>
              ) : (
                "energy saved by avoided calls unknown"
              )
            }
          >
            <span class="big">{joules(group.joules)}</span> <Quality quality={group.quality} />
          </Figure>
        ))}
        {audit?.recall && (
          <Figure
            label="recall against the detector today (UTC)"
            note={
              <span title="Share of the detector's boxes on audited skipped frames that were shown. Against the detector, not the truth.">
                {isClear(audit.recall)
                  ? `${interval(audit.recall)} at 95 % confidence; precision ${percent(audit.precision?.rate)}; not the truth`
                  : `${plural(audit.recall.boxes, "box", "boxes")} compared: too few for a figure`}
              </span>
            }
          >
            <span class="big" id="fleet-recall">{shareOrInterval(audit.recall)}</span>
          </Figure>
        )}
        <Figure label="reports waiting in outboxes">
          <span class="big">{known ? count(known.waiting) : "–"}</span>
        </Figure>
      </dl>
    </section>
  );
}
