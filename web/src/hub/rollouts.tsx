// Rollouts: a value in stages, each gated on what was measured.

import { useState } from "preact/hooks";
import { messageOf, send } from "../shared/api";
import { count, dateTime, parsed, percent, small } from "../shared/format";
import { Pill, Section, whyNot, type Mood } from "../shared/parts";
import { Fault, Field, IntervalBar, Setting, Outcomes, outcomeWords, useLoaded } from "./parts";
import { href } from "./route";
import { terms } from "./tune";
import type { GateResult, RolloutView } from "./types";

const PHASES: Record<string, { words: string; mood: Mood }> = {
  applying: { words: "nodes are getting the value", mood: "wait" },
  soaking: { words: "measuring", mood: "wait" },
  held: { words: "held, waiting for a decision", mood: "bad" },
  finishing: { words: "passed; waiting for nodes out of reach", mood: "good" },
  returning: { words: "old values are returning", mood: "bad" },
  done: { words: "done", mood: "good" },
  returned: { words: "returned to the old values", mood: "bad" },
  stopped: { words: "stopped; nodes keep their values", mood: "none" },
};

function Phase({ rollout }: { rollout: RolloutView }) {
  const phase = PHASES[rollout.phase] ?? { words: rollout.phase, mood: "none" as Mood };
  return (
    <>
      <Pill mood={phase.mood}>{phase.words}</Pill>
      {rollout.paused_ms && <Pill mood="wait">paused</Pill>}
      {rollout.reason && <span class="bad"> {rollout.reason}</span>}
    </>
  );
}

/** Outcomes of a stage after the old values were returned. */
export function afterReturn(counts: Record<string, number>): Record<string, number> {
  const { applied, ...rest } = counts;
  return applied ? { ...rest, returned: applied } : rest;
}

/** One bar per stage: how far its nodes are. */
function Stages({ rollout }: { rollout: RolloutView }) {
  // Nodes that got the value have their old one again.
  const returned = rollout.phase === "returned";
  const over = returned || ["done", "finishing"].includes(rollout.phase);
  return (
    <ol class="stages">
      {rollout.stages.map((stage, index) => {
        const share = stage.nodes && !returned ? (stage.counts.applied ?? 0) / stage.nodes : 0;
        const now = index + 1 === rollout.stage && !over;
        return (
          <li key={index} class={now ? "now" : ""} aria-current={now ? "step" : undefined}>
            <span>
              <b>stage {index + 1}</b> {count(stage.nodes)} new {stage.nodes === 1 ? "node" : "nodes"}
            </span>
            <span class="track" aria-hidden="true">
              <span class="fill state-p" style={{ width: percent(share, 0).replace(/\s/g, "") }} />
            </span>
            <span class="stage-counts">
              <Outcomes counts={returned ? afterReturn(stage.counts) : stage.counts} />
            </span>
          </li>
        );
      })}
    </ol>
  );
}

const VERDICTS: Record<string, Mood> = { passed: "good", failed: "bad", undecided: "wait", not_measured: "none" };
const FIGURES: Record<string, string> = {
  skip_rate: "skip rate", joules_measured: "energy, measured", joules_estimated: "energy, ≈ estimated", edp_measured: "EDP, measured",
  edp_estimated: "EDP, ≈ estimated", latency_p99: "latency p99", degraded: "degraded frames",
};

export function figureWords(figure: string | null | undefined): string {
  return figure ? (FIGURES[figure] ?? figure) : "not measured";
}

export function Gates({ gates }: { gates: GateResult[] }) {
  return (
    <div class="scroll" tabIndex={0} role="group" aria-label="Gates">
      <table>
        <thead>
          <tr>
            <th scope="col" class="left">gate</th>
            <th scope="col" class="left">verdict</th>
            <th scope="col" class="left">figure</th>
            <th scope="col">before</th>
            <th scope="col">after</th>
            <th scope="col" class="left">change, with interval</th>
            <th scope="col">nodes</th>
            <th scope="col">compared with</th>
          </tr>
        </thead>
        <tbody>
          {gates.map((gate) => {
            const words = gate.gate.includes("%") ? signedPercent : signed;
            return (
              <tr key={`${gate.gate} ${gate.figure ?? ""}`}>
                <td class="left"><code>{gate.gate}</code></td>
                <td class="left"><Pill mood={VERDICTS[gate.verdict] ?? "none"}>{gate.verdict.replace("_", " ")}</Pill></td>
                <td class="left">{figureWords(gate.figure)}</td>
                <td>{plainFigure(gate.before)}</td>
                <td>{plainFigure(gate.after)}</td>
                <td class="left">{gate.change ? <IntervalBar interval={gate.change} words={words} /> : "–"}</td>
                <td>{count(gate.nodes)}</td>
                <td>{count(gate.compared)}</td>
              </tr>
            );
          })}
        </tbody>
      </table>
    </div>
  );
}

export function signedPercent(value: number): string {
  return `${value >= 0 ? "+" : ""}${percent(value)}`;
}

export function signed(value: number): string {
  return `${value >= 0 ? "+" : "−"}${plainFigure(Math.abs(value))}`;
}

export function plainFigure(value: number | null | undefined): string {
  if (value === null || value === undefined) return "–";
  return Math.abs(value) >= 100 ? count(Math.round(value)) : String(Number(value.toPrecision(3)));
}

const COMMANDS: { command: string; words: string; in: string[]; danger?: boolean }[] = [
  { command: "pause", words: "Pause", in: ["applying", "soaking"] },
  { command: "resume", words: "Resume", in: [] },
  { command: "next", words: "Next stage now", in: ["applying", "soaking", "held"] },
  { command: "return", words: "Return the old values", in: ["applying", "soaking", "held", "finishing", "done", "stopped"], danger: true },
  { command: "stop", words: "Stop, keep the values", in: ["applying", "soaking", "held", "finishing", "returning"], danger: true },
];

export function Rollout({ id }: { id: string }) {
  const found = useLoaded<RolloutView>(`/api/v1/rollouts/${encodeURIComponent(id)}`, 2000);
  const [fault, setFault] = useState("");
  const forbidden = whyNot();
  const rollout = found.value;
  const command = async (name: string) => {
    setFault("");
    try {
      await send("POST", `/api/v1/rollouts/${encodeURIComponent(id)}/${name}`);
      found.again();
    } catch (error) {
      setFault(messageOf(error));
    }
  };
  const judged = [...(rollout?.record ?? [])].reverse().find((entry) => entry.gates && entry.gates.length > 0);
  const others = (rollout?.nodes ?? []).filter((member) => !["applied", "untouched"].includes(member.outcome));
  return (
    <Section id="rollout" title={`Rollout ${id}`} wide aside={<a href={href(["rollouts"])}>all rollouts</a>}>
      <Fault text={found.fault} />
      {rollout && (
        <>
          <p class="message">
            <Setting value={rollout.to} /> for {rollout.plan.select?.join(", ")} · begun {dateTime(rollout.begun_ms)} by {rollout.who}
            {rollout.plan.why ? `: ${rollout.plan.why}` : ""}
          </p>
          <p class="message">
            <Phase rollout={rollout} />
          </p>
          <Stages rollout={rollout} />
          <div class="row">
            {COMMANDS.filter(({ command, in: phases }) =>
              command === "resume" ? rollout.paused_ms || rollout.phase === "held" : command === "pause" ? !rollout.paused_ms && phases.includes(rollout.phase) : phases.includes(rollout.phase),
            ).map((one) => (
              <button key={one.command} type="button" class={one.danger ? "danger" : "plain"} disabled={forbidden !== undefined} onClick={() => command(one.command)}>
                {one.words}
              </button>
            ))}
          </div>
          {forbidden && <p class="message wait">{forbidden}</p>}
          <Fault text={fault} />
          <h3>Gates{judged ? `, as evaluated ${dateTime(judged.at_ms)} in stage ${judged.stage}` : ""}</h3>
          {judged?.gates ? <Gates gates={judged.gates} /> : <p class="message quiet">Not evaluated yet: {rollout.plan.gates?.join(", ")}</p>}
          <h3>{rollout.phase === "returned" ? "Nodes that did not take part" : "Nodes without the value"}</h3>
          {others.length === 0 ? (
            <p class="message quiet">None of the selected nodes.</p>
          ) : (
            <ul class="events">
              {others.slice(0, 100).map((member) => (
                <li key={member.node}>
                  <a href={href(["nodes", member.node])}>{member.node}</a> {outcomeWords(member.outcome)}
                  {member.detail ? `: ${member.detail}` : ""}
                </li>
              ))}
            </ul>
          )}
          <h3>Record</h3>
          <ol class="events">
            {[...(rollout.record ?? [])].reverse().map((entry, index) => (
              <li key={index}>
                <time class="quiet">{dateTime(entry.at_ms)}</time> stage {entry.stage}: <b>{entry.what}</b> {entry.text}
                {entry.who ? ` (${entry.who})` : ""}
              </li>
            ))}
          </ol>
        </>
      )}
    </Section>
  );
}

export function Rollouts() {
  const found = useLoaded<{ runs: RolloutView[] }>("/api/v1/rollouts", 3000);
  const rollouts = found.value?.runs ?? [];
  return (
    <>
      <Section id="rollouts" title="Rollouts" wide>
        <Fault text={found.fault} />
        {found.value && rollouts.length === 0 && <p class="message quiet">None yet. Start one below.</p>}
        {rollouts.map((rollout) => (
          <article class="card" key={rollout.id}>
            <p class="message">
              <a href={href(["rollouts", String(rollout.id)])}>
                <b>Rollout {rollout.id}</b>
              </a>{" "}
              <Setting value={rollout.to} /> for {rollout.plan.select?.join(", ")} · {dateTime(rollout.begun_ms)} by {rollout.who}{" "}
              <Phase rollout={rollout} />
            </p>
            <Stages rollout={rollout} />
          </article>
        ))}
      </Section>
      <Begin onBegun={found.again} />
    </>
  );
}

function Begin({ onBegun }: { onBegun: () => void }) {
  const [fields, setFields] = useState({
    select: "all", value: "", why: "", stages: "1, 10%, 50%, 90%", soak: "1440", gates: "skip_rate>=-0.05, joules<=+5%?, latency_p99<=+10%, degraded<=+0.01",
    failure: "return",
  });
  const [fault, setFault] = useState("");
  const forbidden = whyNot();
  const field = (name: keyof typeof fields) => ({
    value: fields[name],
    onInput: (event: { currentTarget: { value: string } }) => setFields({ ...fields, [name]: event.currentTarget.value }),
  });
  const value = parsed(fields.value);
  const begin = async (event: Event) => {
    event.preventDefault();
    setFault("");
    const minutes = parsed(fields.soak);
    if (value === undefined) return setFault("Enter the value of u to roll out, such as 5e-4.");
    if (minutes === undefined) return setFault("Enter how many minutes each stage is held.");
    try {
      const begun = await send<RolloutView>("POST", "/api/v1/rollouts", {
        u: value,
        select: terms(fields.select),
        stages: terms(fields.stages),
        gates: terms(fields.gates),
        soak_s: minutes * 60,
        on_failure: fields.failure,
        why: fields.why,
      });
      onBegun();
      location.hash = href(["rollouts", String(begun.id)]);
    } catch (error) {
      setFault(messageOf(error));
    }
  };
  return (
    <Section id="begin" title="Start a rollout" wide>
      <form onSubmit={begin}>
        <div class="fields">
          <Field label="for which nodes: names, globs, labels, or all" wide><input type="text" {...field("select")} /></Field>
          <Field label="u"><input type="text" inputmode="decimal" placeholder="5e-4" {...field("value")} /></Field>
          <Field label="stages: cumulative numbers or shares of nodes" wide><input type="text" {...field("stages")} /></Field>
          <Field label="each held for, minutes"><input type="text" inputmode="decimal" {...field("soak")} /></Field>
          <Field label="gates: bounds on what the change may cost" wide><textarea rows={2} {...field("gates")} /></Field>
          <Field label="when a gate fails">
            <select value={fields.failure} onChange={(event) => setFields({ ...fields, failure: event.currentTarget.value })}>
              <option value="return">return the old values</option>
              <option value="hold">hold, and wait for a decision</option>
            </select>
          </Field>
          <Field label="why" wide><input type="text" maxLength={500} {...field("why")} /></Field>
        </div>
        <p class="message quiet">
          The last stage stays below 100 %: a stage is compared with the nodes that still have the old value, and one of 100 % leaves none. The
          rest gets the value by “Set a threshold” once the rollout is done. A gate that ends in <code>?</code> passes when no node reports its
          figure.
        </p>
        <div class="row">
          <button disabled={forbidden !== undefined}>Start{value !== undefined ? ` with u = ${small(value)}` : ""}</button>
        </div>
        {forbidden && <p class="message wait">{forbidden}</p>}
        <Fault text={fault} />
      </form>
    </Section>
  );
}
