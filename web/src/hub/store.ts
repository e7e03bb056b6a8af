// The page's state of the whole fleet.

import { signal } from "@preact/signals";
import { call, every, follow, json } from "../shared/api";
import type { Mood } from "../shared/parts";
import type { Energy, EnergyGroup, HubReadiness, NodeList, StoredEvent } from "./types";

/** Most events that the page keeps. */
const MOST_EVENTS = 200;
/** Shortest time between two reloads because of events, milliseconds: at most four per second. */
const LEAST_MS = 250;

export const fleet = signal<Pick<NodeList, "counts" | "waiting"> | undefined>(undefined);
export const today = signal<EnergyGroup[] | undefined>(undefined);
/** What the audits of the fleet found today. */
export const auditToday = signal<Energy["audit"] | undefined>(undefined);
export const lost = signal<string | undefined>(undefined);
/** Whether the hub stores reports, and which of its parts do not work. */
export const readiness = signal<HubReadiness | undefined>(undefined);
export const events = signal<StoredEvent[]>([]);
/** Grows when something that is shown may have changed. */
export const changed = signal(0);

/** The same, at most every two seconds: for requests that cost the hub more than a page of rows. */
export const changedSlowly = signal(0);

let scheduled = false;
let slowlyAt = 0;

/** Reloads soon, at most four times per second whatever the number of events. */
export function lookSoon(): void {
  if (scheduled) return;
  scheduled = true;
  setTimeout(() => {
    scheduled = false;
    changed.value += 1;
    if (performance.now() - slowlyAt > 2000) {
      slowlyAt = performance.now();
      changedSlowly.value += 1;
    }
    void lookAtFleet().catch(() => {});
  }, LEAST_MS);
}

async function lookAtFleet(): Promise<void> {
  const { counts, waiting } = await json<NodeList>("/api/v1/nodes?limit=0");
  fleet.value = { counts, waiting };
}

async function lookAtReadiness(): Promise<void> {
  // 503 if it is not ready, with the same fields.
  const response = await call("/readyz");
  const found = (await response.json()) as Partial<HubReadiness>;
  if (found.ready !== undefined) readiness.value = { ready: found.ready, reasons: found.reasons ?? {} };
}

/** What is known of the hub. */
export interface HubFacts {
  /** Why it does not answer. */
  lost?: string | undefined;
  /** Whether it has ever told of its fleet. */
  isKnown: boolean;
  readiness?: HubReadiness | undefined;
}

/** The hub in a word, and why it is not well. */
export function hubState({ lost, isKnown, readiness }: HubFacts): { mood: Mood; word: string; faults: [part: string, reason: string][] } {
  const faults = Object.entries(readiness?.reasons ?? {});
  if (readiness && !readiness.ready) return { mood: "bad", word: "not ready", faults };
  if (lost !== undefined) return { mood: "bad", word: "hub does not answer", faults: [] };
  if (!isKnown) return { mood: "wait", word: "connecting", faults };
  return faults.length > 0 ? { mood: "bad", word: "degraded", faults } : { mood: "good", word: "connected", faults };
}

/** The beginning of the day in UTC, as in the table's figures of today. */
export function midnight(now = Date.now()): number {
  return Math.floor(now / 86_400_000) * 86_400_000;
}

async function lookAtEnergy(): Promise<void> {
  const energy = await json<Energy>(`/api/v1/energy?by=all&since_ms=${midnight()}`);
  today.value = energy.groups;
  auditToday.value = energy.audit ?? undefined;
}

export function watchFleet(signal: AbortSignal): void {
  void follow({
    path: () => "/api/v1/events",
    onEvent: (name, data) => {
      if (name !== "resync") events.value = [data as StoredEvent, ...events.value].slice(0, MOST_EVENTS);
      lookSoon();
    },
    onOpen: async () => {
      await Promise.all([lookAtFleet(), lookAtEnergy()]);
      lost.value = undefined;
      changed.value += 1;
      changedSlowly.value += 1;
    },
    onLost: (reason) => {
      lost.value = reason;
    },
    signal,
  });
  const whileReached = (work: () => Promise<void>) => async () => {
    if (lost.value === undefined) await work();
  };
  void every(3000, signal, whileReached(lookAtFleet));
  void every(3000, signal, async () => {
    try {
      await lookAtReadiness();
    } catch {
      // It does not answer, which the event stream shows.
      readiness.value = undefined;
    }
  });
  void every(20_000, signal, whileReached(lookAtEnergy));
}

/** Energy by quality (qualities are never added), the one with the most clips first. */
export function byQuality(groups: readonly EnergyGroup[]): EnergyGroup[] {
  return [...groups].filter((group) => group.quality !== "unavailable").sort((a, b) => b.clips - a.clips);
}
