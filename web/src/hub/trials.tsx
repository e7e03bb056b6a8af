// Trials: values compared on random groups of nodes.

import { useState } from "preact/hooks";
import { messageOf, send } from "../shared/api";
import { count, dateTime, duration, parsed, percent, small } from "../shared/format";
import { Pill, Section, whyNot, type Mood } from "../shared/parts";
import { Fault, Field, IntervalBar, Setting, Outcomes, useLoaded } from "./parts";
import { afterReturn, figureWords, plainFigure, signed, signedPercent } from "./rollouts";
import { href } from "./route";
import { terms } from "./tune";
import type { TrialView } from "./types";

const PHASES: Record<string, { words: string; mood: Mood }> = {
  applying: { words: "nodes are getting their values", mood: "wait" },
  running: { words: "measuring", mood: "wait" },
  returning: { words: "over; old values are returning", mood: "wait" },
  done: { words: "done", mood: "good" },
};

function Phase({ trial }: { trial: TrialView }) {
  const phase = PHASES[trial.phase] ?? { words: trial.phase, mood: "none" as Mood };
  return <Pill mood={phase.mood}>{phase.words}</Pill>;
}

/** After a trial every node has its old value again. */
function counts(trial: TrialView): Record<string, number> {
  const all: Record<string, number> = {};
  for (const group of trial.stages) {
    for (const [outcome, nodes] of Object.entries(group.counts)) all[outcome] = (all[outcome] ?? 0) + (nodes ?? 0);
  }
  return trial.phase === "done" ? afterReturn(all) : all;
}

/** Whether the difference of a figure is relative to its earlier value. */
function isRelative(figure: string): boolean {
  return /^(joules|edp|latency)/.test(figure);
}

function Values({ trial }: { trial: TrialView }) {
  return <>{(trial.plan.values ?? []).map((value, index) => <span key={index}>{index ? " against " : ""}<Setting value={value} /></span>)}</>;
}

export function Trial({ id }: { id: string }) {
  const found = useLoaded<TrialView>(`/api/v1/trials/${encodeURIComponent(id)}`, 3000);
  const [fault, setFault] = useState("");
  const forbidden = whyNot();
  const trial = found.value;
  const end = async () => {
    setFault("");
    try {
      await send("POST", `/api/v1/trials/${encodeURIComponent(id)}/end`);
      found.again();
    } catch (error) {
      setFault(messageOf(error));
    }
  };
  return (
    <Section id="trial" title={`Trial ${id}`} wide aside={<a href={href(["trials"])}>all trials</a>}>
      <Fault text={found.fault} />
      {trial && (
        <>
          <p class="message">
            <Values trial={trial} /> on {trial.plan.select?.join(", ")} for {duration(trial.plan.duration_s)} · begun {dateTime(trial.begun_ms)} by {trial.who}
            {trial.plan.why ? `: ${trial.plan.why}` : ""}
          </p>
          <p class="message">
            <Phase trial={trial} /> <Outcomes counts={counts(trial)} />
            {trial.ended_by ? ` · ended early by ${trial.ended_by}` : ""}
          </p>
          {["applying", "running"].includes(trial.phase) && (
            <div class="row">
              <button type="button" class="danger" disabled={forbidden !== undefined} onClick={end}>End the trial now</button>
            </div>
          )}
          {forbidden && <p class="message wait">{forbidden}</p>}
          <Fault text={fault} />
          {trial.result ? (
            <div class="scroll" tabIndex={0} role="group" aria-label="Result">
              <table>
                <thead>
                  <tr>
                    <th scope="col" class="left">value</th>
                    <th scope="col" class="left">figure</th>
                    <th scope="col">before</th>
                    <th scope="col">during</th>
                    <th scope="col" class="left">
                      change beyond the first value's; all intervals together at {percent(trial.result.confidence, 0)}
                    </th>
                    <th scope="col">nodes</th>
                    <th scope="col">clips</th>
                  </tr>
                </thead>
                <tbody>
                  {trial.result.values.flatMap((arm, index) =>
                    arm.figures.map((figure) => (
                      <tr key={`${index} ${figure.figure}`}>
                        <td class="left"><Setting value={arm.value} /></td>
                        <td class="left">{figureWords(figure.figure)}</td>
                        <td>{plainFigure(figure.before)}</td>
                        <td>{plainFigure(figure.mean)}</td>
                        <td class="left">
                          {figure.difference ? <IntervalBar interval={figure.difference} words={isRelative(figure.figure) ? signedPercent : signed} /> : "–"}
                        </td>
                        <td>{count(figure.nodes)}</td>
                        <td>{count(figure.clips)}</td>
                      </tr>
                    )),
                  )}
                </tbody>
              </table>
            </div>
          ) : (
            <p class="message quiet">The result appears at the end of the trial.</p>
          )}
        </>
      )}
    </Section>
  );
}

export function Trials() {
  const found = useLoaded<{ runs: TrialView[] }>("/api/v1/trials", 3000);
  const trials = found.value?.runs ?? [];
  return (
    <>
      <Section id="trials" title="Trials" wide>
        <Fault text={found.fault} />
        {found.value && trials.length === 0 && <p class="message quiet">None yet. Start one below.</p>}
        {trials.map((trial) => (
          <article class="card" key={trial.id}>
            <p class="message">
              <a href={href(["trials", String(trial.id)])}><b>Trial {trial.id}</b></a> <Values trial={trial} /> on {trial.plan.select?.join(", ")} ·{" "}
              {dateTime(trial.begun_ms)} by {trial.who} <Phase trial={trial} /> <Outcomes counts={counts(trial)} />
            </p>
          </article>
        ))}
      </Section>
      <Begin onBegun={found.again} />
    </>
  );
}

function Begin({ onBegun }: { onBegun: () => void }) {
  const [fields, setFields] = useState({ select: "all", values: "", minutes: "60", why: "" });
  const [fault, setFault] = useState("");
  const forbidden = whyNot();
  const field = (name: keyof typeof fields) => ({
    value: fields[name],
    onInput: (event: { currentTarget: { value: string } }) => setFields({ ...fields, [name]: event.currentTarget.value }),
  });
  const begin = async (event: Event) => {
    event.preventDefault();
    setFault("");
    const values = terms(fields.values).map(parsed);
    const minutes = parsed(fields.minutes);
    if (values.length < 2 || values.includes(undefined)) return setFault("Enter two or more values of u, such as 3e-4, 5e-4.");
    if (minutes === undefined) return setFault("Enter how many minutes it lasts.");
    try {
      const begun = await send<TrialView>("POST", "/api/v1/trials", {
        values: values.map((u) => ({ u })),
        select: terms(fields.select),
        duration_s: minutes * 60,
        why: fields.why,
      });
      onBegun();
      location.hash = href(["trials", String(begun.id)]);
    } catch (error) {
      setFault(messageOf(error));
    }
  };
  const shown = terms(fields.values).map(parsed).filter((value): value is number => value !== undefined);
  return (
    <Section id="begin" title="Start a trial" wide>
      <form onSubmit={begin}>
        <div class="fields">
          <Field label="on which nodes: names, globs, labels, or all" wide><input type="text" {...field("select")} /></Field>
          <Field label="values of u to compare; the first is the reference"><input type="text" placeholder="3e-4, 5e-4" {...field("values")} /></Field>
          <Field label="duration, minutes"><input type="text" inputmode="decimal" {...field("minutes")} /></Field>
          <Field label="why" wide><input type="text" maxLength={500} {...field("why")} /></Field>
        </div>
        <div class="row">
          <button disabled={forbidden !== undefined}>Start{shown.length > 1 ? `: ${shown.map((value) => small(value)).join(" against ")}` : ""}</button>
        </div>
        {forbidden && <p class="message wait">{forbidden}</p>}
        <Fault text={fault} />
      </form>
    </Section>
  );
}
