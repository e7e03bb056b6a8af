// The current view, stored in the address after #, so that every view has a link and the browser's back button works.

import { signal } from "@preact/signals";

export interface Route {
  /** Parts of the path: `["nodes", "car-7"]`. */
  path: string[];
  query: URLSearchParams;
}

export function parseRoute(hash: string): Route {
  const [path = "", query = ""] = hash.replace(/^#\/?/, "").split("?");
  const parts = path.split("/").filter(Boolean).map(decodeURIComponent);
  return { path: parts.length ? parts : ["fleet"], query: new URLSearchParams(query) };
}

export function href(path: string[], query: Record<string, string | undefined> = {}): string {
  const parameters = new URLSearchParams(
    Object.entries(query).filter((entry): entry is [string, string] => entry[1] !== undefined && entry[1] !== ""),
  ).toString();
  return `#/${path.map(encodeURIComponent).join("/")}${parameters ? `?${parameters}` : ""}`;
}

export const route = signal<Route>(parseRoute(location.hash));

addEventListener("hashchange", () => {
  route.value = parseRoute(location.hash);
});

/** Another query of the same view; typing a search is one step back, not one for each letter. */
export function refine(query: Record<string, string | undefined>): void {
  const before = Object.fromEntries(route.value.query);
  history.replaceState(null, "", href(route.value.path, { ...before, ...query }));
  route.value = parseRoute(location.hash);
}
