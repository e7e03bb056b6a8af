// The head of the page: the node's name and health, the detector's provider, and the energy saved.

import { useComputed } from "@preact/signals";
import { count, duration, joules, percent, plural, small, watts } from "../shared/format";
import { Figure, Pill, Quality, Section, type Mood } from "../shared/parts";
import type { AuditRate, Savings } from "./types";
import { rate } from "./audit";
import { cameras, counters, detector, thresholdSpec, thresholdInForce, lost, missed, opened, overview } from "./store";

type Energy = NonNullable<Savings["energy"]>;

interface State {
  mood: Mood;
  word: string;
  why: string;
}

function state(): State {
  if (lost.value !== undefined) return { mood: "bad", word: "node does not answer", why: "Reconnecting. The page shows the last data received." };
  const now = overview.value;
  if (!now) return { mood: "wait", word: "connecting", why: "" };
  if (now.state === "ready") return { mood: "good", word: "ready", why: "" };
  return { mood: "bad", word: now.state === "degraded" ? "degraded" : "not ready", why: "" };
}

/** The faulty parts on one line; unfolded, each with its reason. */
function Faults() {
  const reasons = overview.value?.reasons ?? [];
  if (reasons.length === 0 || lost.value !== undefined) return null;
  const names = [...new Set(reasons.map(({ part, subject }) => subject || part))];
  const more = names.length > 4 ? ` and ${names.length - 4} more` : "";
  return (
    <details class="faults">
      <summary>
        {plural(reasons.length, "fault")}: {names.slice(0, 4).join(", ")}
        {more}
      </summary>
      <ul class="reasons" tabIndex={0}>
        {reasons.map((reason) => (
          <li key={`${reason.part} ${reason.subject ?? ""}`}>
            <b>
              {reason.part} {reason.subject ?? ""}
            </b>{" "}
            {reason.effect === "not_ready" && "(not ready) "}
            {reason.reason} <span class="quiet">for {duration(reason.since_s)}</span>
          </li>
        ))}
      </ul>
    </details>
  );
}

/** The detector's provider; bad if it is not the first one requested. */
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
      <Faults />
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
              {thresholdSpec.value && (
                <>
                  {", "}
                  {thresholdSpec.value.name} = <b>{small(thresholdInForce.value)}</b>
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

/** One sentence on the detector calls saved and the recall. */
export function headline(savings: Pick<Savings, "frames" | "avoided_calls" | "degraded_frames"> | undefined, camera: string | undefined, recall: AuditRate | null | undefined): string {
  if (!savings?.frames) return "No frame yet.";
  if (savings.degraded_frames === savings.frames) return "Every frame was answered without the detector it needed.";
  const saved = `${percent(savings.avoided_calls / savings.frames, 0)} fewer detector calls`;
  if (!recall) return `${saved}.`;
  const low = (100 * recall.low).toFixed(0);
  const high = (100 * recall.high).toFixed(0);
  return `${saved}; ${camera ? `camera ${camera} ` : ""}shows ${percent(recall.rate, 0)} [${low}, ${high}] of what the detector would have found.`;
}

export function Headline() {
  const recall = counters.value.get(opened.value ?? "")?.audit?.recall;
  return (
    <p class="wide sentence" id="headline">
      {headline(overview.value?.since_start, cameras.value.length > 1 ? opened.value : undefined, recall)}
    </p>
  );
}

/** The energy used and the calls saved by the whole node, since the start and today, and the recall of the opened camera. */
export function Saving() {
  const now = overview.value;
  const all = [...counters.value.values()];
  const whole = now?.since_start;
  const power = all[0]?.watts.find((entry) => entry.domain === "total") ?? all[0]?.watts[0];
  const audit = counters.value.get(opened.value ?? "")?.audit;
  // A node that started today has no other day to show.
  const today = now && whole && now.today.since_ms > whole.since_ms ? now.today : undefined;
  const energy = whole?.energy;
  return (
    <Section id="saving" title="Saving" aside={<span class="quiet">since the start</span>}>
      <dl class="figures">
        <Figure
          label="detector calls avoided"
          note={
            whole?.frames
              ? `${count(whole.avoided_calls)} of ${count(whole.frames)} frames${today?.frames ? `; today (UTC) ${percent(today.avoided_calls / today.frames)}` : ""}`
              : "no frame yet"
          }
        >
          <span class="big">{whole?.frames ? percent(whole.avoided_calls / whole.frames) : "–"}</span>
        </Figure>
        <Figure
          label="recall against the detector"
          note={audit?.recall ? `${rate(audit.recall).replace(/^.*\((.*)\)$/, "$1")} % at 95 % confidence; precision ${percent(audit.precision?.rate)}` : "no audited frame yet"}
        >
          <span class="big">{percent(audit?.recall?.rate)}</span>
        </Figure>
        {energy && (
          <Figure
            label="energy per hour"
            note={
              <>
                {energy.saved_joules_estimated != null && <Saved energy={energy} saved={energy.saved_joules_estimated} />}
                {today?.energy && `; today (UTC) ${joules((today.energy.joules / today.energy.covered_s) * 3600)}`}
              </>
            }
          >
            <span class="big" title={`Sampled for ${duration(energy.covered_s)}`}>
              {joules((energy.joules / energy.covered_s) * 3600)}
            </span>{" "}
            <Quality quality={energy.quality} />
          </Figure>
        )}
        {power && (
          <Figure label="power now">
            <span class="big">{watts(power.watts)}</span> <Quality quality={all[0]!.power_quality} />
          </Figure>
        )}
        {whole && whole.degraded_frames > 0 && (
          <Figure label="degraded frames" note="answered without the detector they needed; not counted as avoided">
            <span class="big bad">{count(whole.degraded_frames)}</span>
          </Figure>
        )}
      </dl>
      {now && !now.outbox.durable && now.outbox.waiting > 0 && (
        <p class="message quiet">
          {plural(now.outbox.waiting, "clip report")} in memory, waiting for a hub. They are lost when the node stops, because no state_dir
          is set.
        </p>
      )}
      {missed.value > 0 && <p class="message wait">This page was too slow for {plural(missed.value, "event")}.</p>}
    </Section>
  );
}

/** The energy that the avoided calls would have added. */
function Saved({ energy, saved }: { energy: Energy; saved: number }) {
  return (
    <span title="Estimated: run time of the avoided detector calls, at most the detector's idle time, times the watts that a running detector adds on this machine.">
      avoided calls saved ≈ {joules((saved / energy.covered_s) * 3600)} ({percent(saved / (energy.joules + saved))})
    </span>
  );
}
