// Calls to the service that serves the page, and its event streams.

import { signal } from "@preact/signals";

export interface Caller {
  name: string;
  token_needed: boolean;
  may_tune: boolean;
}

/** The caller as the service knows it; undefined until the first answer. */
export const caller = signal<Caller | undefined>(undefined);
/** Whether the service refused the token. */
export const tokenRefused = signal(false);

const KEY = "token";
// The token is kept as long as the tab; a token in the address would end up in histories and logs.
let token = sessionStorage.getItem(KEY) ?? "";

/** An error that the service answered. */
export class Refused extends Error {
  constructor(
    readonly status: number,
    detail: string,
  ) {
    super(detail);
  }
}

/** What an error says to the reader of the page. */
export function messageOf(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}

export function call(path: string, options: RequestInit = {}): Promise<Response> {
  const headers = new Headers(options.headers);
  if (token) headers.set("Authorization", `Bearer ${token}`);
  return fetch(path, { ...options, headers, cache: "no-store" });
}

async function refusal(response: Response): Promise<Refused> {
  let detail = response.statusText || `status ${response.status}`;
  try {
    const problem: unknown = await response.json();
    if (typeof problem === "object" && problem !== null && "detail" in problem && typeof problem.detail === "string") {
      detail = problem.detail;
    }
  } catch {
    // A proxy answered: only its status line is useful.
  }
  if (response.status === 401) void askWho();
  return new Refused(response.status, detail);
}

/** The answer, or a `Refused`. */
export async function answer(path: string, options?: RequestInit): Promise<Response> {
  const response = await call(path, options);
  if (!response.ok) throw await refusal(response);
  return response;
}

/** The answer as JSON, of a type from the OpenAPI document. */
export async function json<T>(path: string, options?: RequestInit): Promise<T> {
  return (await (await answer(path, options)).json()) as T;
}

export function send<T>(method: "PUT" | "POST", path: string, body?: unknown, signal?: AbortSignal): Promise<T> {
  const init: RequestInit = { method, headers: { "Content-Type": "application/json" } };
  if (signal) init.signal = signal;
  if (body !== undefined) init.body = JSON.stringify(body);
  return json<T>(path, init);
}

/** Asks the service who the caller is, so that the page can ask for a token before a request is refused. */
export async function askWho(): Promise<Caller> {
  const response = await call("/api/v1/caller");
  if (!response.ok) throw new Refused(response.status, response.statusText);
  const who = (await response.json()) as Caller;
  tokenRefused.value = who.token_needed && token !== "";
  if (who.token_needed && token !== "") forget();
  caller.value = who;
  return who;
}

function forget(): void {
  token = "";
  sessionStorage.removeItem(KEY);
}

/** Uses `text` as the token from now on. */
export async function useToken(text: string): Promise<void> {
  token = text.trim();
  sessionStorage.setItem(KEY, token);
  await askWho();
}

export interface StreamEvent {
  name: string;
  id: string | undefined;
  data: string;
}

/** Parses an event stream's text as its pieces arrive, and returns the complete events. */
export class EventParser {
  #rest = "";

  take(text: string): StreamEvent[] {
    const blocks = (this.#rest + text).split("\n\n");
    this.#rest = blocks.pop() ?? "";
    return blocks.map(parseBlock).filter((event) => event.data !== "");
  }
}

function parseBlock(block: string): StreamEvent {
  const event: StreamEvent = { name: "message", id: undefined, data: "" };
  for (const line of block.split("\n")) {
    if (line.startsWith("event: ")) event.name = line.slice(7);
    else if (line.startsWith("id: ")) event.id = line.slice(4);
    else if (line.startsWith("data: ")) event.data += line.slice(6);
  }
  return event;
}

export interface Following {
  path: () => string;
  onEvent: (name: string, data: unknown) => void;
  /** Called at each connection, before its first event. */
  onOpen?: () => void | Promise<void>;
  onLost?: (reason: string) => void;
  signal: AbortSignal;
}

/**
 * Reads an event stream until aborted. When it breaks, it reconnects after 0.5 s, doubling up to 5 s. EventSource cannot
 * send a token, so the stream is read by hand, with the same `Last-Event-ID`.
 */
export async function follow(stream: Following): Promise<void> {
  let wait = 500;
  let last: string | undefined;
  while (!stream.signal.aborted) {
    let reason = "the connection was closed";
    try {
      const headers = new Headers({ Accept: "text/event-stream" });
      if (last !== undefined) headers.set("Last-Event-ID", last);
      const response = await answer(stream.path(), { headers, signal: stream.signal });
      await stream.onOpen?.();
      const began = performance.now();
      const reader = response.body!.pipeThrough(new TextDecoderStream()).getReader();
      const parser = new EventParser();
      for (;;) {
        const { done, value } = await reader.read();
        if (done) break;
        for (const event of parser.take(value)) {
          if (event.id !== undefined) last = event.id;
          stream.onEvent(event.name, JSON.parse(event.data));
        }
      }
      if (performance.now() - began > 5000) wait = 500;
    } catch (error) {
      reason = messageOf(error);
      if (error instanceof Refused && error.status === 401) return;
    }
    if (stream.signal.aborted) return;
    stream.onLost?.(reason);
    await pause(wait, stream.signal);
    wait = Math.min(2 * wait, 5000);
  }
}

export function pause(ms: number, signal?: AbortSignal): Promise<void> {
  return new Promise((done) => {
    const timer = setTimeout(done, ms);
    signal?.addEventListener("abort", () => {
      clearTimeout(timer);
      done();
    });
  });
}

/** Does `work` now and every `ms` while the page is visible, until aborted. After a failure the next turn tries again. */
export async function every(ms: number, signal: AbortSignal, work: () => Promise<void>): Promise<void> {
  while (!signal.aborted) {
    if (!document.hidden) {
      try {
        await work();
      } catch {
        // Components that show the figure show its age too.
      }
    }
    await pause(ms, signal);
  }
}
