// The five frame states of a camera, counted since the node started.

import { count, percent } from "../shared/format";
import { Section } from "../shared/parts";
import { CAUSES, shownStates } from "./frames";
import type { CallCause } from "./types";
import { counters, opened, rates, tick } from "./store";

const DEGRADED = { state: "–", name: "degraded", meaning: "predicted, because the detector it needed was not available", colour: "block degraded" } as const;

export function States() {
  void tick.value;
  const message = counters.value.get(opened.value ?? "");
  const lately = rates(opened.value ?? "", 60);
  const total = message?.frames ?? 0;
  const degraded = message?.degraded_frames ?? 0;
  return (
    <Section
      id="states"
      title="Frame states"
      aside={
        <span>
          <b id="skip-rate">{percent(message && total ? message.skip_rate : undefined)}</b> skipped
          {lately && <span class="quiet"> · last minute {percent(lately.skipRate)}</span>}
        </span>
      }
    >
      <div class="bars">
        {[...shownStates(message?.states), ...(degraded ? [DEGRADED] : [])].map(({ state, name, meaning, colour }) => {
          // A degraded frame is a predicted one that needed the detector.
          const number = state === "–" ? degraded : (message?.states[state] ?? 0) - (state === "P" ? degraded : 0);
          const share = total ? number / total : 0;
          return (
            <div class="bar" key={state} title={meaning}>
              <b>{state}</b>
              <span class="bar-name">{name}</span>
              <span class="track" aria-hidden="true">
                <span class={`fill ${colour.replace("--", "")}`} style={{ width: `${(100 * share).toFixed(1)}%` }} />
              </span>
              <span class="number">
                {count(number)} · {percent(share)}
              </span>
            </div>
          );
        })}
      </div>
      <Causes calls={message?.calls} />
    </Section>
  );
}

/** Why the detector was called since the node started, the most frequent cause first. */
function Causes({ calls }: { calls: Record<string, number> | undefined }) {
  const known = Object.entries(calls ?? {}).sort(([, a], [, b]) => b - a);
  const total = known.reduce((sum, [, number]) => sum + number, 0);
  if (total === 0) return null;
  return (
    <>
      <h3>Why the detector was called</h3>
      <dl class="causes">
        {known.map(([cause, number]) => {
          const words = CAUSES[cause as CallCause];
          return (
            <div key={cause} title={words?.meaning}>
              <dt>{words?.name ?? cause.replaceAll("_", " ")}</dt>
              <dd>
                {count(number)} <span class="quiet">· {percent(number / total, 0)}</span>
              </dd>
            </div>
          );
        })}
      </dl>
    </>
  );
}
