// The history of changes, nodes that have drifted, and rejected reports.

import { useState } from "preact/hooks";
import { json } from "../shared/api";
import { count, dateTime, plural } from "../shared/format";
import { Section } from "../shared/parts";
import { Fault, Setting, Outcomes, outcomeWords, settingText, useLoaded } from "./parts";
import { href } from "./route";
import type { ChangeDetail, ChangeView, Drift, SetAside } from "./types";

export function Changes() {
  const found = useLoaded<{ changes: ChangeView[]; next?: number | null }>("/api/v1/changes?limit=50", 5000);
  const drift = useLoaded<Drift[]>("/api/v1/drift", 10_000);
  const [older, setOlder] = useState<ChangeView[]>([]);
  const [next, setNext] = useState<number | null | undefined>(undefined);
  const [fault, setFault] = useState("");
  const more = async () => {
    try {
      const page = await json<{ changes: ChangeView[]; next?: number | null }>(`/api/v1/changes?limit=50&before=${next ?? found.value?.next}`);
      setOlder([...older, ...page.changes]);
      setNext(page.next ?? null);
    } catch (error) {
      setFault(error instanceof Error ? error.message : String(error));
    }
  };
  const changes = [...(found.value?.changes ?? []), ...older];
  const hasMore = next === undefined ? found.value?.next : next;
  return (
    <>
      {drift.value && drift.value.length > 0 && (
        <Section id="drift" title="Nodes with local changes" wide aside={<span class="quiet">{plural(drift.value.length, "node")}</span>}>
          <ul class="events">
            {drift.value.slice(0, 100).map((one) => (
              <li key={one.node}>
                <a href={href(["nodes", one.node])}>{one.node}</a> desired <Setting value={one.desired} />, in force{" "}
                {one.in_force ? <Setting value={one.in_force} /> : "not the same on all cameras"}, since {dateTime(one.since_ms)}
                {one.why ? `: ${one.why}` : ""}
                {one.set_back ? `, set back by the hub ${one.set_back} times` : ""}
              </li>
            ))}
          </ul>
        </Section>
      )}
      <Section id="changes" title="Changes" wide>
        <Fault text={found.fault || fault} />
        {found.value && changes.length === 0 && <p class="message quiet">No changes yet.</p>}
        {changes.length > 0 && (
          <div class="scroll" tabIndex={0} role="group" aria-label="table of changes">
            <table>
              <thead>
                <tr>
                  {["revision", "when", "who", "value", "for", "origin", "why", "outcome"].map((head) => (
                    <th key={head} scope="col" class="left">{head}</th>
                  ))}
                </tr>
              </thead>
              <tbody>
                {changes.map((change) => (
                  <tr key={change.revision}>
                    <td class="left"><a href={href(["changes", String(change.revision)])}>{change.revision}</a></td>
                    <td class="left">{dateTime(change.at_ms)}</td>
                    <td class="left">{change.who}</td>
                    <td class="left"><Setting value={change.to} /></td>
                    <td class="left clip-text" title={change.select}>{change.select}</td>
                    <td class="left">{change.origin}</td>
                    <td class="left clip-text" title={change.why}>{change.why}</td>
                    <td class="left"><Outcomes counts={change.counts} /></td>
                  </tr>
                ))}
              </tbody>
            </table>
          </div>
        )}
        {hasMore && <button type="button" class="plain" onClick={more}>Show older changes</button>}
      </Section>
    </>
  );
}

export function Change({ id }: { id: string }) {
  const found = useLoaded<ChangeDetail>(`/api/v1/changes/${encodeURIComponent(id)}`, 3000);
  const change = found.value;
  const order = ["refused", "timed_out", "waiting", "pending", "superseded", "applied", "unchanged"];
  const nodes = [...(change?.nodes ?? [])].sort((a, b) => order.indexOf(a.outcome) - order.indexOf(b.outcome) || a.node.localeCompare(b.node));
  return (
    <Section id="change" title={`Revision ${id}`} wide aside={<a href={href(["changes"])}>all changes</a>}>
      <Fault text={found.fault} />
      {change && (
        <>
          <p class="message">
            <Setting value={change.to} /> for {change.select || change.origin} · {dateTime(change.at_ms)} by {change.who} ({change.origin})
            {change.why ? `: ${change.why}` : ""}
          </p>
          <p class="message"><Outcomes counts={change.counts} /></p>
          <ul class="events">
            {nodes.slice(0, 300).map((node) => (
              <li key={node.node}>
                <a href={href(["nodes", node.node])}>{node.node}</a> {outcomeWords(node.outcome)}
                {node.from ? ` (from ${settingText(node.from)})` : ""}
                {node.detail ? `: ${node.detail}` : ""} <time class="quiet">{dateTime(node.at_ms)}</time>
              </li>
            ))}
            {nodes.length > 300 && <li class="quiet">… and {count(nodes.length - 300)} more</li>}
          </ul>
        </>
      )}
    </Section>
  );
}

export function Aside() {
  const found = useLoaded<{ reports: SetAside[]; next?: number | null }>("/api/v1/set-aside?limit=100", 10_000);
  const reports = found.value?.reports ?? [];
  return (
    <Section id="aside" title="Reports set aside" wide>
      <p class="message quiet">These reports could not be parsed or had impossible figures. They were acknowledged, so they do not block later reports, and are kept here with the reason.</p>
      <Fault text={found.fault} />
      {found.value && reports.length === 0 && <p class="message good">None.</p>}
      {reports.map((report) => (
        <details class="card" key={report.id}>
          <summary>
            <time class="quiet">{dateTime(report.received_ms)}</time> <a href={href(["nodes", report.node])}>{report.node}</a>: {report.cause}
          </summary>
          <pre tabIndex={0}>{report.body}</pre>
        </details>
      ))}
      {found.value?.next && <p class="message quiet">The latest 100 are shown.</p>}
    </Section>
  );
}
