// Sets a value or a target on selected nodes, and shows the outcome per node as it arrives.

import { signal } from "@preact/signals";
import { useState } from "preact/hooks";
import { answer, messageOf, send } from "../shared/api";
import { parsed, plural, small } from "../shared/format";
import { Section, whyNot } from "../shared/parts";
import { TARGETS } from "../shared/target";
import { selected } from "./fleet";
import { Fault, Field, Outcomes, outcomeWords, settingText } from "./parts";
import { href, route } from "./route";
import { lookSoon } from "./store";
import type { NodeSetting, Revision } from "./types";

/** Most lines of outcomes that are shown; the counts include all. */
const SHOWN = 100;
/** How long the outcomes are followed, seconds. */
const FOLLOW_S = 120;

/** The last setting given, kept while the page shows another view. */
const given = signal<{ counts: Record<string, number>; lines: NodeSetting[]; dry: boolean; running: boolean; revision?: number } | undefined>(undefined);

/** The terms of a text: names, globs and labels between commas. */
export function terms(text: string): string[] {
  return text.split(",").map((term) => term.trim()).filter(Boolean);
}

/** Parses a text with one JSON object per line, as its pieces arrive. */
export class LineParser {
  #rest = "";

  take(text: string): unknown[] {
    const lines = (this.#rest + text).split("\n");
    this.#rest = lines.pop() ?? "";
    return lines.filter((line) => line.trim() !== "").map((line) => JSON.parse(line) as unknown);
  }
}

/** The prefix of a target's name in the list of thresholds: a threshold may have the same name. */
const HOLD = "hold ";
const NOTHING = `${HOLD}nothing`;

/** The path of a setting and the fields of its body; undefined while a number is missing. */
export function request(what: string, number: number | undefined): { path: string; fields: Record<string, unknown> } | undefined {
  const path = what.startsWith(HOLD) ? "/api/v1/target" : "/api/v1/threshold";
  if (what === NOTHING) return { path, fields: { target: null } };
  if (number === undefined) return undefined;
  return { path, fields: what.startsWith(HOLD) ? { target: { [what.slice(HOLD.length)]: number } } : { [what]: number } };
}

export function countOutcomes(lines: Iterable<{ outcome: string }>): Record<string, number> {
  const counts: Record<string, number> = {};
  for (const line of lines) counts[line.outcome] = (counts[line.outcome] ?? 0) + 1;
  return counts;
}

function placeholder(what: string): string {
  if (what === NOTHING) return "";
  return TARGETS.find((target) => HOLD + target.name === what)?.begin ?? "5e-4";
}

/** The text of the button. */
function buttonText(what: string, number: number | undefined): string {
  if (what === NOTHING) return "Hold nothing";
  const verb = what.startsWith(HOLD) ? "Hold" : "Set";
  return number === undefined ? verb : `${verb} ${what.replace(HOLD, "")} = ${small(number)}`;
}

export function Tune() {
  const [select, setSelect] = useState("");
  const [name, setName] = useState("u");
  const [value, setValue] = useState("");
  const [why, setWhy] = useState("");
  const [fault, setFault] = useState("");
  const picked = [...selected.value].sort();
  // The typed selector counts; otherwise the checked boxes; otherwise the table's filter.
  const filtered = route.value.query.get("select") ?? "";
  const chosen = terms(select).length ? terms(select) : picked.length ? picked : terms(filtered);
  const forbidden = whyNot();
  const number = parsed(value);
  const what = request(name, number);
  const body = { ...what?.fields, select: chosen, why };

  const attempt = async (work: () => Promise<void>) => {
    setFault("");
    if (chosen.length === 0) return setFault("Choose nodes: select some above, or enter names, globs, labels or “all”.");
    if (!what) return setFault(`Enter a value for ${name.replace(HOLD, "")}, such as ${placeholder(name)}.`);
    try {
      await work();
    } catch (error) {
      setFault(messageOf(error));
    }
  };
  const dry = () =>
    attempt(async () => {
      const found = await send<Revision>("PUT", what!.path, { ...body, dry_run: true });
      given.value = { counts: found.counts, lines: found.nodes, dry: true, running: false };
    });
  const set = (event: Event) => {
    event.preventDefault();
    return attempt(async () => {
      const response = await answer(what!.path, {
        method: "PUT",
        headers: { "Content-Type": "application/json", Accept: "application/x-ndjson" },
        body: JSON.stringify({ ...body, wait_s: FOLLOW_S }),
      });
      const byNode = new Map<string, NodeSetting>();
      const show = (running: boolean, revision?: number) => {
        const lines = [...byNode.values()];
        given.value = { counts: countOutcomes(lines), lines, dry: false, running, revision };
      };
      show(true);
      const reader = response.body!.pipeThrough(new TextDecoderStream()).getReader();
      const parser = new LineParser();
      let painted = 0;
      for (;;) {
        const { done, value } = await reader.read();
        if (done) break;
        for (const line of parser.take(value)) {
          const last = line as { revision?: number | null; counts?: object };
          // The last line has the sums.
          if (last.counts !== undefined) show(false, last.revision ?? undefined);
          else byNode.set((line as NodeSetting).node, line as NodeSetting);
        }
        // Thousands may arrive at once.
        if (given.value?.running && performance.now() - painted > 200) {
          painted = performance.now();
          show(true);
        }
      }
      if (given.value?.running) show(false);
      lookSoon();
    });
  };

  const said = given.value;
  const interesting = said?.lines.filter((line) => said.dry || !["applied", "unchanged"].includes(line.outcome)) ?? [];
  return (
    <Section id="tune" title="Set a threshold or a target" wide>
      <form onSubmit={set}>
        <div class="fields">
          <Field label="for which nodes: names, globs, labels, or all" wide>
            <input
              type="text"
              value={select}
              placeholder={picked.length ? `the ${plural(picked.length, "node")} selected above` : filtered || "cam-*, region=north"}
              onInput={(event) => setSelect(event.currentTarget.value)}
            />
          </Field>
          <Field label="threshold or target">
            <select value={name} onChange={(event) => setName(event.currentTarget.value)}>
              <optgroup label="a threshold">
                {["u", "lambda", "n", "skip_rate", "threshold", "component_size", "drift"].map((name) => (
                  <option key={name}>{name}</option>
                ))}
              </optgroup>
              <optgroup label="a target instead">
                {TARGETS.map((target) => (
                  <option key={target.name} value={HOLD + target.name}>
                    hold {target.name}
                  </option>
                ))}
                <option>{NOTHING}</option>
              </optgroup>
            </select>
          </Field>
          <Field label="value">
            <input
              type="text"
              inputmode="decimal"
              autocomplete="off"
              placeholder={placeholder(name)}
              disabled={name === NOTHING}
              value={name === NOTHING ? "" : value}
              onInput={(event) => setValue(event.currentTarget.value)}
            />
          </Field>
          <Field label="why (kept in the history)" wide>
            <input type="text" maxLength={500} value={why} onInput={(event) => setWhy(event.currentTarget.value)} />
          </Field>
        </div>
        <div class="row">
          <button type="button" class="plain" onClick={dry}>
            Show who would change
          </button>
          <button disabled={forbidden !== undefined || said?.running}>{buttonText(name, number)}</button>
          <span class="quiet">
            for {chosen.length === 0 ? "no node yet" : chosen.length > 4 ? plural(chosen.length, "term") : chosen.join(", ")}
          </span>
        </div>
        {forbidden && <p class="message wait">{forbidden}</p>}
        <Fault text={fault} />
      </form>
      {said && (
        <div class="given" role="status" aria-live="polite">
          <p class="message">
            {said.dry ? "Nothing was changed: " : said.running ? "Waiting for the nodes: " : "Given: "}
            <Outcomes counts={said.counts} />
            {said.revision !== undefined && (
              <>
                {" · "}
                <a href={href(["revisions", String(said.revision)])}>revision {said.revision}</a>
              </>
            )}
          </p>
          {interesting.length > 0 && (
            <ul class="events">
              {interesting.slice(0, SHOWN).map((line) => (
                <li key={line.node}>
                  <a href={href(["nodes", line.node])}>{line.node}</a> {outcomeWords(line.outcome)}
                  {line.from ? ` (from ${settingText(line.from)})` : ""}
                  {line.detail ? `: ${line.detail}` : ""}
                </li>
              ))}
              {interesting.length > SHOWN && <li class="quiet">… and {interesting.length - SHOWN} more</li>}
            </ul>
          )}
        </div>
      )}
    </Section>
  );
}
