// The head of the page: the node's name and health, the detector's provider, and the energy saved.

import { useComputed } from "@preact/signals";
import { count, dateTime, duration, interval, isClear, percent, plural, shareOrInterval, small, watts } from "../shared/format";
import { Figure, isPage, Pill, Quality, Section, type Mood } from "../shared/parts";
import type { AuditFigures, AuditRate, Savings } from "./types";
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
          <div>
            <dt>interface</dt>
            <dd>
              <a href="/docs/">/docs</a>
            </dd>
          </div>
          {isPage(now.hub) && (
            <div>
              <dt>hub</dt>
              <dd>
                <a href={`${now.hub.replace(/\/$/, "")}/#/nodes/${encodeURIComponent(now.node)}`}>its page there</a>
              </dd>
            </div>
          )}
        </dl>
      )}
    </header>
  );
}

/** One sentence on the detector calls saved and, once it is known well enough, the recall. */
export function headline(savings: Pick<Savings, "frames" | "avoided_calls" | "degraded_frames"> | undefined, camera: string | undefined, recall: AuditRate | null | undefined): string {
  if (!savings?.frames) return "No frame yet.";
  if (savings.degraded_frames === savings.frames) return "Every frame was answered without the detector it needed.";
  const saved = `${percent(savings.avoided_calls / savings.frames, 0)} fewer detector calls`;
  if (!recall || !isClear(recall)) return `${saved}.`;
  return `${saved}; ${camera ? `camera ${camera} ` : ""}shows ${percent(recall.rate, 0)} of what the detector would have found.`;
}

export function Headline() {
  const recall = counters.value.get(opened.value ?? "")?.audit?.recall;
  return (
    <p class="wide sentence" id="headline">
      {headline(overview.value?.since_switch ?? overview.value?.since_start, cameras.value.length > 1 ? opened.value : undefined, recall)}
    </p>
  );
}

/** What the figures of a power source are of. */
const MEASURED: Record<string, string> = {
  ina: "the board",
  tegrastats: "the board",
  rapl: "the processor, all programs (RAPL)",
  nvml: "the graphics cards, all programs",
  "rapl+nvml": "processor and graphics cards, all programs",
  command: "what power.command measures",
  estimate: "the machine, from its processor's load",
};

export function whatIsMeasured(source: string | undefined): string {
  return MEASURED[source ?? ""] ?? source ?? "";
}

/** The calls saved and the power used by the whole node, since the start and today, and the recall of the opened camera. */
export function Saving() {
  const now = overview.value;
  const all = [...counters.value.values()];
  const whole = now?.since_switch ?? now?.since_start;
  const power = all[0]?.watts.find((entry) => entry.domain === "total") ?? all[0]?.watts[0];
  const audit = counters.value.get(opened.value ?? "")?.audit;
  // A node that started today has no other day to show, and a day may have seen several policies.
  const today = now && whole && !now.since_switch && now.today.since_ms > whole.since_ms ? now.today : undefined;
  // Before the first frame it is the power of a machine that does something else.
  const energy = whole?.frames ? whole.energy : undefined;
  return (
    <Section id="saving" title="Saving" aside={<span class="quiet">{now?.since_switch ? `under ${now.policy}, since ${dateTime(now.since_switch.since_ms)}` : "since the start"}</span>}>
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
        <Recall audit={audit} />
        {energy && (
          <Figure
            label={`power of ${whatIsMeasured(now?.power_source)}`}
            note={
              <>
                mean since {now?.since_switch ? "then" : "the start"}{power && `; now ${watts(power.watts)}`}
                {today?.energy && `; today (UTC) ${watts(today.energy.joules / today.energy.covered_s)}`}
                {energy.saved_joules_estimated != null && <Saved energy={energy} saved={energy.saved_joules_estimated} />}
              </>
            }
          >
            <span class="big" title={`Sampled for ${duration(energy.covered_s)}`}>
              {watts(energy.joules / energy.covered_s)}
            </span>{" "}
            <Quality quality={energy.quality} />
          </Figure>
        )}
        {whole && whole.degraded_frames > 0 && (
          <Figure label="degraded frames" note="answered without the detector they needed; not counted as avoided">
            <span class="big bad">{count(whole.degraded_frames)}</span>
          </Figure>
        )}
      </dl>
      {now && !now.outbox.durable && now.outbox.waiting > 0 && now.reasons.some(({ part }) => part === "uplink") && (
        <p class="message quiet">
          {plural(now.outbox.waiting, "clip report")} in memory, waiting for a hub. They are lost when the node stops, because no state_dir
          is set.
        </p>
      )}
      {missed.value > 0 && <p class="message wait">This page was too slow for {plural(missed.value, "event")}.</p>}
    </Section>
  );
}

/** The recall of the opened camera; while few boxes were compared, only where it lies. */
function Recall({ audit }: { audit: AuditFigures | null | undefined }) {
  const { recall, precision } = audit ?? {};
  const note = !recall
    ? "no audited frame yet"
    : isClear(recall)
      ? `${interval(recall)} at 95 % confidence; precision ${percent(precision?.rate)}`
      : `${plural(recall.boxes, "box", "boxes")} compared: too few for a figure`;
  return (
    <Figure label="recall against the detector" note={note}>
      <span class="big">{shareOrInterval(recall)}</span>
    </Figure>
  );
}

/** The energy that the avoided calls would have added. */
function Saved({ energy, saved }: { energy: Energy; saved: number }) {
  return (
    <span title="Estimated: run time of the avoided detector calls, at most the detector's idle time, times the watts that a running detector adds on this machine.">
      ; without the avoided calls ≈ {watts(saved / energy.covered_s)} more ({percent(saved / (energy.joules + saved))} saved)
    </span>
  );
}
