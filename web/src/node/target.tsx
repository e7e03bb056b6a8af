// A target instead of a fixed threshold: its value, the measured value, and its status.

import { useEffect, useState } from "preact/hooks";
import { every, json, messageOf, send } from "../shared/api";
import { duration, parsed, plural, small } from "../shared/format";
import { Section, whyNot } from "../shared/parts";
import { nameAndValue, TARGETS, type TargetName } from "../shared/target";
import { overview, thresholdSpec } from "./store";
import type { TargetReport } from "./types";

const LOOK_MS = 2000;

export function TargetPanel() {
  const policy = overview.value?.policy;
  const [report, setReport] = useState<TargetReport | undefined>(undefined);
  const [name, setName] = useState<TargetName>("skip_rate");
  const [text, setText] = useState("0.5");
  const [said, setSaid] = useState<string | undefined>(undefined);
  useEffect(() => {
    const stop = new AbortController();
    void every(LOOK_MS, stop.signal, async () => setReport(await json<TargetReport>("/api/v1/target", { signal: stop.signal })));
    return () => stop.abort();
    // A switch of the policy ends a target that it cannot hold.
  }, [policy]);
  // A controller moves only these thresholds.
  if (!report || !["u", "lambda"].includes(thresholdSpec.value?.name ?? "")) return null;
  const set = async (target: Record<string, number> | null) => {
    try {
      setReport(await send<TargetReport>("PUT", "/api/v1/target", { target }));
      setSaid(undefined);
    } catch (error) {
      setSaid(messageOf(error));
    }
  };
  const submit = (event: Event) => {
    event.preventDefault();
    const value = parsed(text);
    if (value === undefined) setSaid(`“${text}” is not a number`);
    else void set({ [name]: value });
  };
  const held = nameAndValue(report.target);
  const about = TARGETS.find((target) => target.name === held?.name);
  const unit = TARGETS.find((target) => target.name === name)?.unit;
  const forbidden = whyNot();
  const state = report.state;
  return (
    <Section
      id="target"
      title="Target"
      aside={<span id="target-why">{held ? (report.why ?? "starting") : (report.off ?? `none: ${thresholdSpec.value!.name} stays as set`)}</span>}
    >
      <form onSubmit={submit}>
        {held && (
          <p class="message" id="target-state">
            {about?.words ?? held.name} <b>{small(held.value)}</b> {about?.unit}, now{" "}
            <b id="target-actual">{small(state?.actual)}</b>; {thresholdSpec.value!.name} is <b>{small(state?.threshold)}</b>, allowed {small(report.range?.least)} to{" "}
            {small(report.range?.most)}.
            {state && state.unmet > 0 && ` Not met for ${duration(state.unmet_s)} in total.`}
            {state?.boxes !== undefined && state?.boxes !== null && ` Based on ${plural(state.boxes, "box", "boxes")}.`}
          </p>
        )}
        <div class="row">
          <label for="target-name">Hold</label>
          <select
            id="target-name"
            value={name}
            onChange={(event) => {
              const chosen = TARGETS.find((target) => target.name === event.currentTarget.value);
              if (chosen) {
                setName(chosen.name);
                setText(chosen.begin);
              }
            }}
          >
            {TARGETS.map((target) => <option key={target.name} value={target.name}>{target.words}</option>)}
          </select>
          <input
            id="target-value"
            type="text"
            inputmode="decimal"
            autocomplete="off"
            aria-label="value of the target"
            value={text}
            onInput={(event) => setText(event.currentTarget.value)}
          />
          <span class="quiet">{unit}</span>
          <button disabled={forbidden !== undefined}>Hold</button>
          {held && (
            <button type="button" class="plain" disabled={forbidden !== undefined} onClick={() => void set(null)}>
              Hold nothing
            </button>
          )}
        </div>
        <p id="target-message" class="message bad" role="alert">
          {forbidden ?? said ?? ""}
        </p>
        <p class="message quiet">A controller sets {thresholdSpec.value!.name} for all cameras together. Setting it by hand turns the target off.</p>
      </form>
    </Section>
  );
}
