// Rows of the fleet's table: only those near the visible part are kept, whatever the fleet's size.

import { json, messageOf } from "../shared/api";
import { href } from "./route";
import type { NodeList, NodeView } from "./types";

export const PAGE = 100;
/** Pages held: what is scrolled past is let go. */
const MOST_PAGES = 12;

export interface Filter {
  state: string;
  search: string;
  select: string;
  sort: string;
  down: boolean;
}

export function path(filter: Filter, offset: number, limit: number): string {
  const query = href([], {
    state: filter.state,
    search: filter.search,
    select: filter.select,
    sort: filter.sort,
    down: filter.down ? "true" : undefined,
    offset: String(offset),
    limit: String(limit),
  });
  return `/api/v1/nodes${query.slice(2)}`;
}

export class Rows {
  total = 0;
  fault = "";
  #pages = new Map<number, NodeView[]>();
  #wanted = new Set<number>();
  #loading = new Set<number>();
  #stopped = new AbortController();

  constructor(
    readonly filter: Filter,
    /** Called when there is something new to show. */
    readonly onNews: () => void,
  ) {}

  at(index: number): NodeView | undefined {
    return this.#pages.get(Math.floor(index / PAGE))?.[index % PAGE];
  }

  get held(): number {
    return this.#pages.size;
  }

  /** Sees to it that the rows from `first` to `last` come. */
  want(first: number, last: number): void {
    this.#wanted = new Set();
    for (let page = Math.floor(Math.max(0, first) / PAGE); page <= Math.floor(Math.max(0, last) / PAGE); page += 1) {
      this.#wanted.add(page);
      if (!this.#pages.has(page)) void this.#load(page);
    }
    for (const page of this.#pages.keys()) {
      if (this.#pages.size <= MOST_PAGES) break;
      if (!this.#wanted.has(page)) this.#pages.delete(page);
    }
  }

  /** Reloads the visible rows. */
  refresh(): void {
    for (const page of this.#wanted) void this.#load(page);
  }

  stop(): void {
    this.#stopped.abort();
  }

  async #load(page: number): Promise<void> {
    if (this.#loading.has(page)) return;
    this.#loading.add(page);
    try {
      const found = await json<NodeList>(path(this.filter, page * PAGE, PAGE), { signal: this.#stopped.signal });
      this.total = found.total;
      this.fault = "";
      this.#pages.set(page, found.nodes);
    } catch (error) {
      if (this.#stopped.signal.aborted) return;
      this.fault = messageOf(error);
    } finally {
      this.#loading.delete(page);
    }
    if (!this.#stopped.signal.aborted) this.onNews();
  }
}

/** The names of all rows of a filter, at most `most`. */
export async function names(filter: Filter, most: number): Promise<{ names: string[]; total: number }> {
  const found: string[] = [];
  let total = 0;
  do {
    const page = await json<NodeList>(path({ ...filter, sort: "name" }, found.length, 500));
    total = page.total;
    if (page.nodes.length === 0) break;
    found.push(...page.nodes.map((node) => node.node));
  } while (found.length < Math.min(total, most));
  return { names: found.slice(0, most), total };
}
