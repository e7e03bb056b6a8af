// The head of the page: which node, how it is, what runs the detector, what was saved.

import { useComputed } from "@preact/signals";
import { count, duration, joules, percent, small, watts } from "../shared/format";
import { Figure, Pill, Quality, type Mood } from "../shared/parts";
import type { Savings } from "./types";
import { counters, detector, knob, knobInForce, lost, missed, overview } from "./store";

type Energy = NonNullable<Savings["energy"]>;

interface State {
  mood: Mood;
  word: string;
  why: string;
}

function state(): State {
  if (lost.value !== undefined) return { mood: "bad", word: "node does not answer", why: "Trying again. What is shown is the last that was heard." };
  const now = overview.value;
  if (!now) return { mood: "wait", word: "connecting", why: "" };
  const reasons = now.reasons.map((reason) => {
    const subject = reason.subject ? ` ${reason.subject}` : "";
    return `${reason.part}${subject}: ${reason.reason} (for ${duration(reason.since_s)})`;
  });
  const why = reasons.join("; ");
  if (now.state === "ready") return { mood: "good", word: "ready", why };
  return { mood: "bad", word: now.state === "degraded" ? "degraded" : "not ready", why };
}

/** Whether the detector runs on something else than what was asked for first. */
function provider(): { mood: Mood; text: string } {
  const now = overview.value;
  const runs = detector.value?.provider ?? now?.provider;
  if (!runs) return { mood: "wait", text: "no provider yet" };
  const wanted = now?.requested_providers[0];
  return wanted && wanted !== runs
    ? { mood: "bad", text: `${runs}, not ${wanted}` }
    : { mood: "none", text: runs };
}

export function Header() {
  const is = useComputed(state).value;
  const runs = useComputed(provider).value;
  const now = overview.value;
  const name = now?.node;
  if (name) document.title = `${name} · albireo`;
  return (
    <header>
      <h1>
        <span class="quiet">albireo</span> {name ?? "…"}
      </h1>
      <span role="status">
        <Pill mood={is.mood}>{is.word}</Pill>
      </span>
      {is.why && <span class="why">{is.why}</span>}
      {now && (
        <dl class="facts">
          <div>
            <dt>runs on</dt>
            <dd class={runs.mood}>{runs.text}</dd>
          </div>
          <div>
            <dt>policy</dt>
            <dd>
              {now.policy}
              {knob.value && (
                <>
                  {", "}
                  {knob.value.name} = <b>{small(knobInForce.value)}</b>
                </>
              )}
            </dd>
          </div>
          <div>
            <dt>up</dt>
            <dd>{duration(now.uptime_s)}</dd>
          </div>
          <div>
            <dt>version</dt>
            <dd>{now.version}</dd>
          </div>
        </dl>
      )}
    </header>
  );
}

/** What the whole node used and saved, since the start and today. */
export function Headline() {
  const now = overview.value;
  const all = [...counters.value.values()];
  const whole = now?.since_start;
  const power = all[0]?.watts.find((entry) => entry.domain === "total") ?? all[0]?.watts[0];
  // A node that began today has no other day to tell from.
  const days: [string, Savings][] = !now || !whole ? [] : now.today.since_ms > whole.since_ms
    ? [["since the start", whole], ["today", now.today]]
    : [["since the start (today)", whole]];
  return (
    <section class="wide headline" aria-label="What was saved">
      <dl class="figures">
        {days.map(([words, period]) => (
          <Figure
            key={words}
            label={`detector calls avoided ${words}`}
            note={period.frames ? `${count(period.avoided_calls)} of ${count(period.frames)} frames` : "no frame yet"}
          >
            <span class="big">{period.frames ? percent(period.avoided_calls / period.frames) : "–"}</span>
          </Figure>
        ))}
        {days.length === 0 && (
          <Figure label="detector calls avoided" note="no frame yet">
            <span class="big">–</span>
          </Figure>
        )}
        {days.map(
          ([words, { energy }]) =>
            energy && (
              <Figure
                key={`energy ${words}`}
                label={`energy per hour ${words}, sampled for ${duration(energy.covered_s)}`}
                note={energy.saved_joules_estimated != null && <Saved energy={energy} saved={energy.saved_joules_estimated} />}
              >
                <span class="big">{joules((energy.joules / energy.covered_s) * 3600)}</span> <Quality quality={energy.quality} />
              </Figure>
            ),
        )}
        {power && (
          <Figure label="power now" note={<Quality quality={all[0]!.power_quality} />}>
            <span class="big">{watts(power.watts)}</span>
          </Figure>
        )}
        {whole && whole.degraded_frames > 0 && (
          <Figure label="answered without the detector it needed" note="degraded frames: not among the avoided">
            <span class="big bad">{count(whole.degraded_frames)}</span>
          </Figure>
        )}
      </dl>
      {now && days.length > 1 && <p class="message quiet">Today is the day of UTC.</p>}
      {now && !now.outbox.durable && now.outbox.waiting > 0 && (
        <p class="message quiet">
          {count(now.outbox.waiting)} clip reports wait for a hub in memory: no state_dir is set, so they are gone when the
          node stops.
        </p>
      )}
      {missed.value > 0 && <p class="message wait">This page was too slow for {count(missed.value)} events.</p>}
    </section>
  );
}

/** What the avoided calls would have added to that energy. */
function Saved({ energy, saved }: { energy: Energy; saved: number }) {
  return (
    <span title="Run time of the avoided detector calls, no longer than the detector was idle, times the watts that a running detector adds on this machine.">
      avoided calls saved {joules((saved / energy.covered_s) * 3600)} per hour ({percent(saved / (energy.joules + saved))}){" "}
      <Quality quality="estimated" />
    </span>
  );
}
