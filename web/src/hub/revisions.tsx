// The history of desired settings, nodes that have drifted, and rejected reports.

import { useState } from "preact/hooks";
import { json, messageOf } from "../shared/api";
import { count, dateTime, plural } from "../shared/format";
import { Section } from "../shared/parts";
import { Fault, Setting, Outcomes, outcomeWords, settingText, useLoaded } from "./parts";
import { href } from "./route";
import type { Drift, Revision, SetAside } from "./types";

export function Revisions() {
  const found = useLoaded<{ revisions: Revision[]; next?: number | null }>("/api/v1/revisions?limit=50", 5000);
  const drift = useLoaded<Drift[]>("/api/v1/drift", 10_000);
  const [older, setOlder] = useState<Revision[]>([]);
  const [next, setNext] = useState<number | null | undefined>(undefined);
  const [fault, setFault] = useState("");
  const more = async () => {
    try {
      const page = await json<{ revisions: Revision[]; next?: number | null }>(`/api/v1/revisions?limit=50&before=${next ?? found.value?.next}`);
      setOlder([...older, ...page.revisions]);
      setNext(page.next ?? null);
    } catch (error) {
      setFault(messageOf(error));
    }
  };
  const revisions = [...(found.value?.revisions ?? []), ...older];
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
      <Section id="revisions" title="Desired settings" wide>
        <Fault text={found.fault || fault} />
        {found.value && revisions.length === 0 && <p class="message quiet">No setting was given yet.</p>}
        {revisions.length > 0 && (
          <div class="scroll" tabIndex={0} role="group" aria-label="table of revisions">
            <table>
              <thead>
                <tr>
                  {["revision", "when", "who", "value", "for", "origin", "why", "outcome"].map((head) => (
                    <th key={head} scope="col" class="left">{head}</th>
                  ))}
                </tr>
              </thead>
              <tbody>
                {revisions.map((revision) => (
                  <tr key={revision.revision}>
                    <td class="left"><a href={href(["revisions", String(revision.revision)])}>{revision.revision}</a></td>
                    <td class="left">{dateTime(revision.at_ms)}</td>
                    <td class="left">{revision.who}</td>
                    <td class="left"><Setting value={revision.to} /></td>
                    <td class="left clip-text" title={revision.select}>{revision.select}</td>
                    <td class="left">{revision.origin}</td>
                    <td class="left clip-text" title={revision.why}>{revision.why}</td>
                    <td class="left"><Outcomes counts={revision.counts} /></td>
                  </tr>
                ))}
              </tbody>
            </table>
          </div>
        )}
        {hasMore && <button type="button" class="plain" onClick={more}>Show older revisions</button>}
      </Section>
    </>
  );
}

export function OneRevision({ id }: { id: string }) {
  const found = useLoaded<Revision>(`/api/v1/revisions/${encodeURIComponent(id)}`, 3000);
  const revision = found.value;
  const ranks = ["refused", "timed_out", "waiting", "pending", "superseded", "applied", "unchanged"];
  const nodes = [...(revision?.nodes ?? [])].sort((a, b) => ranks.indexOf(a.outcome) - ranks.indexOf(b.outcome) || a.node.localeCompare(b.node));
  return (
    <Section id="revision" title={`Revision ${id}`} wide aside={<a href={href(["revisions"])}>all revisions</a>}>
      <Fault text={found.fault} />
      {revision && (
        <>
          <p class="message">
            <Setting value={revision.to} /> for {revision.select || revision.origin} · {dateTime(revision.at_ms)} by {revision.who} ({revision.origin})
            {revision.why ? `: ${revision.why}` : ""}
          </p>
          <p class="message"><Outcomes counts={revision.counts} /></p>
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
