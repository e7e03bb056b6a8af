// The fleet as a table: as many elements as fit on the screen, refilled while scrolling.

import { signal } from "@preact/signals";
import type { JSX } from "preact";
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { messageOf } from "../shared/api";
import { ago, count, dateTime, joules, percent, plural, small } from "../shared/format";
import { CopyButton, Section } from "../shared/parts";
import { arrow, type Order } from "../shared/table";
import { nameAndValue } from "../shared/target";
import { Fault, Presence, useLoaded } from "./parts";
import { href, refine, route } from "./route";
import { names, Rows, type Filter } from "./rows";
import { changed, events, fleet, lost } from "./store";
import { Tune } from "./tune";
import type { NodeList, NodeView } from "./types";

/** Height of a row: two lines of a long name. */
const HEIGHT = 44;
/** Most names of one selection. For larger selections labels are the better tool. */
const MOST_SELECTED = 1000;

/** Most nodes that are named with their reason; the table has all. */
const MOST_NAMED = 800;

export const selected = signal<ReadonlySet<string>>(new Set());

/** Name of the threshold of a node's first camera, with the values of all cameras. */
export function thresholdOf(node: NodeView): NodeThreshold | undefined {
  const all = (node.status?.cameras ?? []).flatMap(({ threshold }) => threshold ?? []);
  const name = all[0]?.name;
  if (name === undefined) return undefined;
  const values = all.filter((one) => one.name === name).map((one) => one.value);
  return { name, values: [...new Set(values)] };
}

interface NodeThreshold {
  name: string;
  /** Each value once. */
  values: number[];
}

function thresholdText(threshold: NodeThreshold | undefined): string {
  if (!threshold) return "–";
  const { name, values } = threshold;
  return values.length === 1 ? `${name} = ${small(values[0])}` : `${name}: ${values.length} values`;
}

const COLUMNS: { id: string; head: string; sort?: string; class: string }[] = [
  { id: "name", head: "node", sort: "name", class: "c-name" },
  { id: "state", head: "state", sort: "state", class: "c-state" },
  { id: "since", head: "since", sort: "since", class: "c-since" },
  { id: "heard", head: "heard", sort: "heard", class: "c-heard" },
  { id: "threshold", head: "threshold", class: "c-threshold" },
  { id: "skip", head: "skipped", class: "c-skip" },
  { id: "recall", head: "recall", class: "c-recall" },
  { id: "provider", head: "runs on", class: "c-provider" },
  { id: "joules", head: "energy today (UTC)", sort: "joules", class: "c-joules" },
  { id: "waiting", head: "waiting", sort: "waiting", class: "c-waiting" },
  { id: "labels", head: "labels", class: "c-labels" },
];

function filterOf(query: URLSearchParams): Filter {
  return {
    state: query.get("state") ?? "",
    search: query.get("search") ?? "",
    select: query.get("select") ?? "",
    // What needs attention first.
    sort: query.get("sort") ?? "state",
    down: query.has("sort") ? query.get("down") === "true" : true,
  };
}

export function Fleet() {
  return isEmpty() ? <Empty /> : <Table />;
}

function Table() {
  const filter = filterOf(route.value.query);
  const key = JSON.stringify(filter);
  const [, setTurn] = useState(0);
  const rows = useMemo(() => new Rows(filter, () => setTurn((turn) => turn + 1)), [key]);
  useEffect(() => () => rows.stop(), [rows]);
  const scroller = useRef<HTMLDivElement>(null);
  // The row at the top, not the pixel: the drawn rows change only with it.
  const [top, setTop] = useState(0);
  const [view, setView] = useState(600);

  useEffect(() => {
    const element = scroller.current!;
    const observer = new ResizeObserver(() => setView(element.clientHeight));
    observer.observe(element);
    return () => observer.disconnect();
  }, []);
  useEffect(() => {
    scroller.current!.scrollTop = 0;
    setTop(0);
  }, [key]);

  const first = Math.max(0, top - 2);
  const slots = Math.ceil(view / HEIGHT) + 5;
  const last = Math.min(first + slots, Math.max(rows.total, 1)) - 1;
  useEffect(() => rows.want(first, last), [rows, first, last]);

  // Rows are read again when a visible one has changed, and every three seconds for their ages.
  const news = changed.value;
  useEffect(() => {
    if (lost.value === undefined) rows.refresh();
  }, [news, rows]);
  useEffect(() => {
    const timer = setInterval(() => {
      if (!document.hidden && lost.value === undefined) rows.refresh();
    }, 3000);
    return () => clearInterval(timer);
  }, [rows]);

  const shown: number[] = [];
  for (let index = first; index <= last && index < rows.total; index += 1) shown.push(index);
  const order: Order = filter.down ? "descending" : "ascending";
  // States begin with the worst, everything else with the least.
  const sort = (id: string) => {
    const down = filter.sort === id ? !filter.down : id === "state";
    refine({ sort: id, down: down ? "true" : undefined });
  };
  const picked = selected.value;
  // An unchanged row reuses its element, so it is not compared again.
  const drawn = useRef(new Map<number, { index: number; node: NodeView | undefined; picked: boolean; element: JSX.Element }>());
  const row = (index: number) => {
    const node = rows.at(index);
    const slot = index % slots;
    const on = node !== undefined && picked.has(node.node);
    const known = drawn.current.get(slot);
    if (known && known.index === index && known.node === node && known.picked === on) return known.element;
    // The element that scrolls out at one end is reused at the other.
    const element = <Row key={slot} index={index} node={node} picked={on} />;
    drawn.current.set(slot, { index, node, picked: on, element });
    return element;
  };

  return (
    <>
      <Attention />
      <Section
        id="fleet"
        title="Nodes"
        wide
        aside={<span class="quiet" role="status">{plural(rows.total, "node")}{filter.state || filter.search || filter.select ? " match" : ""}</span>}
      >
        <Filters filter={filter} />
        <Fault text={rows.fault} />
        <div class="fleet" role="table" aria-label="Nodes" aria-rowcount={rows.total + 1}>
          <div role="rowgroup">
            <div class="fleet-row fleet-head" role="row" aria-rowindex={1}>
              <span role="columnheader" class="c-pick">
                <span class="hidden">selected</span>
              </span>
              {COLUMNS.map((column) => (
                <span
                  key={column.id}
                  role="columnheader"
                  class={column.class}
                  aria-sort={column.sort && filter.sort === column.sort ? order : undefined}
                >
                  {column.sort ? (
                    <button type="button" class="sort" onClick={() => sort(column.sort!)}>
                      {column.head}
                      <span aria-hidden="true">{filter.sort === column.sort ? arrow(order) : ""}</span>
                    </button>
                  ) : (
                    column.head
                  )}
                </span>
              ))}
            </div>
          </div>
          <div
            class="fleet-body"
            role="rowgroup"
            tabIndex={0}
            ref={scroller}
            style={{ height: `min(60vh, 40rem, ${Math.max(3, rows.total) * HEIGHT + 2}px)` }}
            onScroll={(event) => setTop(Math.floor(event.currentTarget.scrollTop / HEIGHT))}
          >
            <div role="presentation" style={{ height: `${Math.max(1, rows.total) * HEIGHT}px` }}>
              {shown.map((index) => row(index))}
            </div>
          </div>
        </div>
        {rows.total === 0 && !rows.fault && <p class="message quiet">No node matches.</p>}
        <Picker filter={filter} total={rows.total} />
      </Section>
      <Tune />
      <Happened />
    </>
  );
}

/** Whether no node has ever reported. */
function isEmpty(): boolean {
  return fleet.value !== undefined && Object.values(fleet.value.counts).every((nodes) => nodes === 0);
}

/** How a node gets to a hub that has none. */
function Empty() {
  const host = /^(localhost|127\.|\[::1\])/.test(location.hostname) ? "127.0.0.1" : location.hostname;
  const node = `[uplink]\nconnect = ["tcp/${host}:7448"]`;
  const hub = `[zenoh]\nlisten = ["tcp/0.0.0.0:7448"]`;
  return (
    <Section id="fleet" title="No node has reported to this hub yet" wide>
      <ol class="steps">
        <li>
          In the configuration of each node, <code>node.toml</code>, write where this hub listens for nodes (port 7448, unless{" "}
          <code>zenoh.listen</code> in <code>hub.toml</code> has another), then restart the node:
          <pre tabIndex={0}>{node}</pre>
          <CopyButton text={node} />
        </li>
        <li>
          By default only this machine can reach the hub's port for nodes. For nodes on other machines, in a network that you trust, write
          into <code>hub.toml</code> and restart the hub:
          <pre tabIndex={0}>{hub}</pre>
          <CopyButton text={hub} /> For other networks docs/deploy.md has certificates and a router.
        </li>
        <li>
          Nodes appear here within seconds of their start. To see a fleet without any: <code>albireo simulate --nodes 20</code>
        </li>
      </ol>
    </Section>
  );
}

/** The nodes that do not work, worst first, with all of the reason. */
function Attention() {
  const [most, setMost] = useState(8);
  const counts = fleet.value?.counts;
  const total = (counts?.offline ?? 0) + (counts?.silent ?? 0) + (counts?.degraded ?? 0);
  const found = useLoaded<NodeList>(total ? `/api/v1/nodes?state=offline,silent,degraded&sort=state&down=true&limit=${most}` : undefined, 5000);
  const nodes = found.value?.nodes ?? [];
  if (total === 0) return null;
  return (
    <Section id="attention" title="Needs attention" wide aside={<span class="bad">{plural(total, "node")}</span>}>
      <Fault text={found.fault} />
      <ul class="attention">
        {nodes.map((node) => (
          <li key={node.node}>
            <Presence state={node.state} /> <a href={href(["nodes", node.node])}>{node.node}</a>{" "}
            <span class="quiet">for {ago(Math.max(0, (Date.now() - node.since_ms) / 1000)).replace(" ago", "")}</span> {node.why}
          </li>
        ))}
      </ul>
      {nodes.length < total && nodes.length < MOST_NAMED && (
        <button type="button" class="plain" onClick={() => setMost(Math.min(MOST_NAMED, most * 10))}>
          Show more of the other {count(total - nodes.length)}
        </button>
      )}
    </Section>
  );
}

function pick(node: string, on: boolean): void {
  const next = new Set(selected.value);
  if (on) next.add(node);
  else next.delete(node);
  selected.value = next;
}

function Row(props: { index: number; node: NodeView | undefined; picked: boolean }) {
  const { index, node } = props;
  const place = { transform: `translateY(${index * HEIGHT}px)` };
  if (!node) {
    return (
      <div class="fleet-row coming" role="row" aria-rowindex={index + 2} style={place}>
        <span role="cell" class="c-name quiet">
          …
        </span>
      </div>
    );
  }
  const threshold = thresholdOf(node);
  const value = thresholdText(threshold);
  const held = nameAndValue(node.status?.target?.target);
  const heard = node.heard_ms ? (Date.now() - node.heard_ms) / 1000 : undefined;
  const since = Math.max(0, (Date.now() - node.since_ms) / 1000);
  // Addresses of pages are links on the node's own view.
  const shown = Object.entries(node.status?.labels ?? {}).filter(([label]) => label !== "page" && label !== "hub");
  const labels = shown.map(([label, value]) => `${label}=${value}`).join(" ");
  return (
    <div class="fleet-row" role="row" aria-rowindex={index + 2} style={place}>
      <span role="cell" class="c-pick">
        <input
          type="checkbox"
          aria-label={`select ${node.node}`}
          checked={props.picked}
          onChange={(event) => pick(node.node, event.currentTarget.checked)}
        />
      </span>
      <span role="cell" class="c-name">
        <a href={href(["nodes", node.node])} class={node.node.length > 24 ? "long" : undefined}>
          {node.node}
        </a>
      </span>
      <span role="cell" class="c-state">
        <Presence state={node.state} />
      </span>
      <span role="cell" class="c-since" title={node.why}>
        {ago(since).replace(" ago", "")}
      </span>
      <span role="cell" class="c-heard">
        {heard === undefined ? "never" : ago(Math.max(0, heard))}
      </span>
      <span role="cell" class="c-threshold" title={held && `now ${value}`}>
        {held ? `hold ${held.name} = ${small(held.value)}` : value}
      </span>
      <span role="cell" class="c-skip" title="Share of today's frames that skipped the detector">
        {percent(node.today.skip_rate)}
      </span>
      <span role="cell" class="c-recall" title="Share of the detector's boxes on audited skipped frames of today that were shown">
        {percent(node.today.recall)}
      </span>
      <span role="cell" class="c-provider">
        {node.status?.provider ?? "–"}
      </span>
      <span role="cell" class="c-joules">
        <Today energy={node.today} />
      </span>
      <span role="cell" class="c-waiting">
        {count(node.waiting)}
      </span>
      <span role="cell" class="c-labels" title={labels}>
        {labels}
      </span>
    </div>
  );
}

/** The energy that a node used today; measured and estimated figures are never added. */
function Today({ energy }: { energy: NodeView["today"] }) {
  const { measured_joules: measured, estimated_joules: estimated } = energy;
  if (measured === 0 && estimated === 0) return <>–</>;
  return (
    <>
      {measured > 0 && joules(measured)}
      {measured > 0 && estimated > 0 && ", "}
      {estimated > 0 && <span title="estimated, not measured">≈ {joules(estimated)}</span>}
    </>
  );
}

function Filters({ filter }: { filter: Filter }) {
  const [select, setSelect] = useState(filter.select);
  useEffect(() => setSelect(filter.select), [filter.select]);
  const states = ["online", "degraded", "silent", "offline"];
  const chosen = new Set(filter.state.split(",").filter(Boolean));
  const toggle = (state: string) => {
    if (chosen.has(state)) chosen.delete(state);
    else chosen.add(state);
    refine({ state: [...chosen].join(",") || undefined });
  };
  return (
    <form
      class="filters"
      onSubmit={(event) => {
        event.preventDefault();
        refine({ select: select.trim() || undefined });
      }}
    >
      <label class="field">
        <span>part of the name</span>
        <input type="search" value={filter.search} onInput={(event) => refine({ search: event.currentTarget.value || undefined })} />
      </label>
      <label class="field">
        <span>names, globs, labels</span>
        <input
          type="search"
          placeholder="cam-*, region=north"
          value={select}
          onInput={(event) => setSelect(event.currentTarget.value)}
          onChange={(event) => refine({ select: event.currentTarget.value.trim() || undefined })}
        />
      </label>
      <div class="field" role="group" aria-label="States">
        <span>only nodes that are</span>
        <div class="row">
          {states.map((state) => (
            <button key={state} type="button" class="plain chip" aria-pressed={chosen.has(state)} onClick={() => toggle(state)}>
              <span aria-hidden="true">{chosen.has(state) ? "✓ " : ""}</span>
              {state}
            </button>
          ))}
        </div>
      </div>
    </form>
  );
}

function Picker({ filter, total }: { filter: Filter; total: number }) {
  const [said, setSaid] = useState("");
  const all = async () => {
    setSaid("");
    try {
      const found = await names(filter, MOST_SELECTED);
      selected.value = new Set(found.names);
      if (found.total > found.names.length) {
        setSaid(`The first ${count(found.names.length)} of ${count(found.total)}: for more, use a glob or a label below.`);
      }
    } catch (error) {
      setSaid(messageOf(error));
    }
  };
  const picked = selected.value.size;
  return (
    <div class="row picker">
      <button type="button" class="plain" onClick={all} disabled={total === 0}>
        Select all matches
      </button>
      <button type="button" class="plain" onClick={() => (selected.value = new Set())} disabled={picked === 0}>
        Select none
      </button>
      <span role="status" class="quiet">
        {picked ? `${plural(picked, "node")} selected` : "no node selected"}
      </span>
      {said && <span class="wait">{said}</span>}
    </div>
  );
}

/** The latest events since this page was opened. */
function Happened() {
  const known = events.value.slice(0, 12);
  return (
    <Section id="happened" title="Events" wide aside={<span class="quiet">since this page was opened</span>}>
      {known.length === 0 ? (
        <p class="message quiet">No events yet.</p>
      ) : (
        <ul class="events">
          {known.map((event) => (
            <li key={event.id}>
              <time class="quiet">{dateTime(event.at_ms)}</time> <b>{event.kind.replace("_", " ")}</b>{" "}
              {event.node && <a href={href(["nodes", event.node])}>{event.node}</a>} {detail(event.detail)}
            </li>
          ))}
        </ul>
      )}
    </Section>
  );
}

function detail(value: unknown): string {
  if (typeof value !== "object" || value === null) return value === undefined || value === null ? "" : String(value);
  // The reason, if there is one; the rest is on the node's own page.
  if ("reason" in value && typeof value.reason === "string") return value.reason;
  return Object.entries(value)
    .filter(([, entry]) => entry !== null && entry !== "")
    .map(([key, entry]) => `${key.replaceAll("_", " ")} ${typeof entry === "object" ? JSON.stringify(entry) : String(entry)}`)
    .join(", ");
}
