// The five frame states of a camera, counted since the node started.

import { count, percent } from "../shared/format";
import { Section } from "../shared/parts";
import { STATES } from "./frames";
import { counters, opened, rates, tick } from "./store";

export function States() {
  void tick.value;
  const message = counters.value.get(opened.value ?? "");
  const lately = rates(opened.value ?? "", 60);
  const total = message?.frames ?? 0;
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
        {STATES.map(({ state, name, meaning, colour }) => {
          const number = message?.states[state] ?? 0;
          const share = total ? number / total : 0;
          return (
            <div class="bar" key={state} title={meaning}>
              <b>{state}</b>
              <span class="bar-name">{name}</span>
              <span class="track" aria-hidden="true">
                <span class={`fill ${colour.slice(2)}`} style={{ width: `${(100 * share).toFixed(1)}%` }} />
              </span>
              <span class="number">
                {count(number)} · {percent(share)}
              </span>
            </div>
          );
        })}
      </div>
    </Section>
  );
}
