// The last lines of the node's log, and the diagnostics as one file.

import { useEffect, useRef, useState } from "preact/hooks";
import { every, json } from "../shared/api";
import { dateTime } from "../shared/format";
import { Download, Section } from "../shared/parts";
import type { LogLine } from "./types";

const MOST = 300;
const EVERY_MS = 2000;
const LEVELS = ["ERROR", "WARN", "INFO"] as const;
const MOODS: Record<string, string> = { ERROR: "bad", WARN: "wait" };

/** Lines of a level or a more severe one. */
export function graver(lines: readonly LogLine[], least: string): LogLine[] {
  const place = (level: string) => {
    const at = (LEVELS as readonly string[]).indexOf(level);
    return at === -1 ? LEVELS.length : at;
  };
  return lines.filter((line) => least === "all" || place(line.level) <= place(least));
}

export function Log({ name }: { name: string | undefined }) {
  const [lines, setLines] = useState<LogLine[]>([]);
  const [least, setLeast] = useState("all");
  const [shown, setShown] = useState(false);
  const scroller = useRef<HTMLDivElement>(null);
  const atEnd = useRef(true);

  useEffect(() => {
    if (!shown) return;
    const stop = new AbortController();
    let last = 0;
    void every(EVERY_MS, stop.signal, async () => {
      const found = await json<{ lines: LogLine[] }>(`/api/v1/log?after=${last}&limit=${MOST}`, { signal: stop.signal });
      if (found.lines.length === 0) {
        // Nothing new, or the node restarted: its numbers start again too.
        const newest = (await json<{ lines: LogLine[] }>("/api/v1/log?limit=1", { signal: stop.signal })).lines.at(-1);
        if (newest && newest.number < last) last = 0;
        return;
      }
      const begins = last === 0;
      last = found.lines.at(-1)!.number;
      setLines((known) => (begins ? found.lines : [...known, ...found.lines]).slice(-MOST));
    });
    return () => stop.abort();
  }, [shown]);

  const kept = graver(lines, least);
  useEffect(() => {
    const element = scroller.current;
    if (element && atEnd.current) element.scrollTop = element.scrollHeight;
  }, [kept.length, lines.at(-1)?.number]);

  return (
    <Section
      id="log"
      title="Log"
      wide
      aside={
        <div class="row controls">
          {shown && (
            <label>
              <span class="quiet">level</span>{" "}
              <select value={least} onChange={(event) => setLeast(event.currentTarget.value)}>
                <option value="all">all</option>
                <option value="INFO">info and above</option>
                <option value="WARN">warnings and errors</option>
                <option value="ERROR">errors</option>
              </select>
            </label>
          )}
          <button type="button" class="plain" aria-expanded={shown} onClick={() => setShown(!shown)}>
            {shown ? "Hide" : "Show the last lines"}
          </button>
          <Download path="/api/v1/diag" name={`albireo-node-${name ?? "node"}.tar`}>
            Download all for a diagnosis
          </Download>
        </div>
      }
    >
      {shown && (
        <div
          class="log"
          ref={scroller}
          tabIndex={0}
          role="log"
          aria-label="last lines of the log"
          onScroll={(event) => {
            const { scrollHeight, scrollTop, clientHeight } = event.currentTarget;
            atEnd.current = scrollHeight - scrollTop - clientHeight < 30;
          }}
        >
          {kept.length === 0 && <p class="quiet">No lines at this level.</p>}
          {kept.map((line) => (
            <p key={line.number}>
              <time class="quiet">{dateTime(line.at_ms)}</time> <b class={MOODS[line.level] ?? "quiet"}>{line.level}</b>{" "}
              <span class="quiet">{line.target}</span> {line.text}
            </p>
          ))}
        </div>
      )}
    </Section>
  );
}
