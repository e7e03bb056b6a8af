// The policy: switched with one click, and why the default is the default.

import { useEffect, useState } from "preact/hooks";
import { json, messageOf, send } from "../shared/api";
import { Section, whyNot } from "../shared/parts";
import { lookAtNode, overview } from "./store";
import type { PolicyInForce } from "./types";

const PATH = "/api/v1/policy";

/** The policy that a click offers: the other one of the two that most people choose between. */
export function offered(name: string): string {
  return name === "expected-loss" ? "albireo" : "expected-loss";
}

export function PolicyPanel() {
  const name = overview.value?.policy;
  const [known, setKnown] = useState<PolicyInForce | undefined>(undefined);
  const [chosen, setChosen] = useState("");
  const [said, setSaid] = useState<string | undefined>(undefined);
  // Somebody else may switch it, too.
  useEffect(() => {
    const stop = new AbortController();
    void json<PolicyInForce>(PATH, { signal: stop.signal })
      .then(setKnown)
      .catch(() => {});
    return () => stop.abort();
  }, [name]);
  if (!known) return null;
  const switchTo = async (name: string) => {
    try {
      setKnown(await send<PolicyInForce>("PUT", PATH, { name }));
      // The other cards follow the policy in force.
      await lookAtNode();
      setChosen("");
      setSaid(undefined);
    } catch (error) {
      setSaid(messageOf(error));
    }
  };
  const forbidden = whyNot();
  const next = offered(known.name);
  const others = known.policies.filter((name) => name !== known.name);
  return (
    <Section id="policy" title="Policy" aside={<span>in force: <b id="policy-in-force">{known.name}</b></span>}>
      <p class="row">
        <button type="button" disabled={forbidden !== undefined} onClick={() => void switchTo(next)}>
          Switch to {next}
        </button>
        <span class="quiet">from each camera’s next frame on, with the threshold that node.toml has for it</span>
      </p>
      {known.notes.map((note) => (
        <p class="message wait" key={note}>{note}</p>
      ))}
      <p id="policy-message" class="message bad" role="alert">
        {forbidden ?? said ?? ""}
      </p>
      <details class="policy">
        <summary>Which policy?</summary>
        <p class="message">
          The default, <code>albireo</code>, is the paper's loop: this program is its implementation, and u is what people come to tune. With half
          of the detector's calls, <code>expected-loss</code> was at +1.5 points of AP@50 [−0.1, +3.1] on recordings kept apart from its tuning.
          The others serve for comparison.
        </p>
        <form
          class="row"
          onSubmit={(event) => {
            event.preventDefault();
            void switchTo(chosen || others[0]!);
          }}
        >
          <label for="policy-name">Another one</label>
          <select id="policy-name" value={chosen || others[0]} onChange={(event) => setChosen(event.currentTarget.value)}>
            {others.map((name) => <option key={name} value={name}>{name}</option>)}
          </select>
          <button disabled={forbidden !== undefined}>Switch</button>
        </form>
        <p class="message quiet">
          A switch forgets the objects, and ends the open clip, whose report names the policy of its frames.{" "}
          {known.survives_restart ? "It survives a restart." : "It is lost at a restart: no state_dir is set."}
          {known.name !== known.configured && ` node.toml has ${known.configured}.`}
        </p>
      </details>
    </Section>
  );
}
