// Small parts of the hub's page.

import type { ComponentChildren } from "preact";
import { useEffect, useState } from "preact/hooks";
import { json, messageOf } from "../shared/api";
import { joules, short, small } from "../shared/format";
import { Pill, type Mood } from "../shared/parts";
import { nameAndValue } from "../shared/target";

export { Download, Fault } from "../shared/parts";
import { changedSlowly } from "./store";
import type { DesiredSetting, EnergyGroup, Interval, PresenceState, Threshold } from "./types";

const MOODS: Record<PresenceState, Mood> = { online: "good", degraded: "bad", silent: "wait", offline: "bad" };

export function Presence({ state }: { state: PresenceState }) {
  return <Pill mood={MOODS[state]}>{state}</Pill>;
}

/** Numbers of nodes by outcome, in the order of interest. */
const OUTCOMES = ["refused", "timed_out", "missed", "waiting", "pending", "superseded", "returned", "would_change", "applied", "unchanged", "untouched"];
const OUTCOME_WORDS: Record<string, string> = {
  applied: "in force",
  returned: "old value again",
  unchanged: "already had it",
  would_change: "would change",
  refused: "refused",
  timed_out: "did not report in time",
  waiting: "out of reach, gets it when it returns",
  pending: "given, no answer yet",
  superseded: "replaced by a later revision",
  missed: "out of reach until the deadline",
  untouched: "not given yet",
};
const OUTCOME_MOODS: Record<string, Mood> = { applied: "good", unchanged: "good", refused: "bad", timed_out: "bad", missed: "bad", waiting: "wait" };

export function outcomeWords(outcome: string): string {
  return OUTCOME_WORDS[outcome] ?? outcome;
}

export function Outcomes({ counts }: { counts: Record<string, number> }) {
  const known = Object.keys(counts).sort((a, b) => OUTCOMES.indexOf(a) - OUTCOMES.indexOf(b));
  if (known.length === 0) return <span class="quiet">no node yet</span>;
  return (
    <span class="outcomes">
      {known.map((outcome) => (
        <span key={outcome} class={OUTCOME_MOODS[outcome] ?? "none"}>
          <b>{counts[outcome]}</b> {outcomeWords(outcome)}
        </span>
      ))}
    </span>
  );
}

export function Setting({ value }: { value: DesiredSetting | Threshold | null | undefined }) {
  return <span class="nowrap">{settingText(value)}</span>;
}

/** A threshold or a desired setting: `u = 3.0×10⁻⁴`, `hold skip_rate = 0.5`. */
export function settingText(value: DesiredSetting | Threshold | null | undefined): string {
  if (!value) return "–";
  if ("threshold" in value) return settingText(value.threshold);
  if ("name" in value) return `${value.name} = ${small(value.value)}`;
  const held = nameAndValue(value.target);
  return held ? `hold ${held.name} = ${small(held.value)}` : "hold nothing";
}

/** An interval drawn on a line around zero, with its numbers beside it. */
export function IntervalBar({ interval, words }: { interval: Interval; words: (value: number) => string }) {
  const reach = Math.max(Math.abs(interval.lower), Math.abs(interval.upper), 1e-12) * 1.15;
  const place = (value: number) => `${(50 + (50 * value) / reach).toFixed(1)}%`;
  return (
    <span class="interval">
      <span class="interval-line" aria-hidden="true">
        <span class="zero" />
        <span class="range" style={{ left: place(interval.lower), width: `${((50 * (interval.upper - interval.lower)) / reach).toFixed(1)}%` }} />
        <span class="estimate" style={{ left: place(interval.estimate) }} />
      </span>
      <span>
        {words(interval.estimate)} <span class="quiet">({words(interval.lower)} to {words(interval.upper)})</span>
      </span>
    </span>
  );
}

export interface Loaded<T> {
  value: T | undefined;
  fault: string;
  again: () => void;
}

/** The answer of a path. It is loaded again every `everyMs`, on request, and, if `everyMs` is below 10 s, when the fleet changed. */
export function useLoaded<T>(path: string | undefined, everyMs = 10_000): Loaded<T> {
  const [value, setValue] = useState<T | undefined>(undefined);
  const [fault, setFault] = useState("");
  const [turn, setTurn] = useState(0);
  const news = changedSlowly.value;
  useEffect(() => setValue(undefined), [path]);
  useEffect(() => {
    if (path === undefined) return;
    const stop = new AbortController();
    const look = async () => {
      try {
        const found = await json<T>(path, { signal: stop.signal });
        setValue(found);
        setFault("");
      } catch (error) {
        if (!stop.signal.aborted) setFault(messageOf(error));
      }
    };
    void look();
    const timer = setInterval(() => {
      if (!document.hidden) void look();
    }, everyMs);
    return () => {
      clearInterval(timer);
      stop.abort();
    };
  }, [path, turn, everyMs < 10_000 ? news : 0, everyMs]);
  return { value, fault, again: () => setTurn((turn) => turn + 1) };
}

export function Field({ label, children, wide }: { label: string; children: ComponentChildren; wide?: boolean }) {
  return (
    <label class={wide ? "field wide-field" : "field"}>
      <span>{label}</span>
      {children}
    </label>
  );
}

/** Whether the energy of any avoided call is known. */
export const knowsSaved = (group: EnergyGroup) => group.avoided_calls === 0 || group.unpriced_calls < group.avoided_calls;

/** The energy that avoided calls would have added, where nodes know the cost of a call. */
export function Saved({ group }: { group: EnergyGroup }) {
  if (!knowsSaved(group)) return <>–</>;
  const without = group.unpriced_calls > 0 ? `, excluding ${short(group.unpriced_calls)} calls of unknown cost` : "";
  return (
    <>
      {joules(group.saved_joules_estimated)}
      {without}
    </>
  );
}
