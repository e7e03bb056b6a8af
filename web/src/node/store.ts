// The page's state of the node: filled from its event streams and a few requests, read by the components.

import { computed, signal } from "@preact/signals";
import { answer, caller, every, follow, json } from "../shared/api";
import { FrameLog, past } from "./frames";
import type {
  CameraEntry, CameraHistory, CameraSlot, ClipReport, Counters, DetectorEvent, Frame, Overview, PowerHistory, Threshold,
  Thresholds,
} from "./types";

/** Most frames of the opened camera that the page keeps: minutes, and at most some megabytes. */
export const MOST_FRAMES = 6000;
/** Most counter samples kept, one per second. */
const MOST_SAMPLES = 3600;
/** Most clips kept, as many as in the node. */
const MOST_CLIPS = 256;
/** Most frames requested from the node's history. */
const MOST_PAST = 4000;

export interface Sample {
  /** Seconds since the Unix epoch. */
  at: number;
  frames: number;
  skipped: number;
  degraded: number;
}

export interface PowerSample {
  at: number;
  watts: Record<string, number>;
}

export const overview = signal<Overview | undefined>(undefined);
/** Why the node cannot be reached; undefined while it can. */
export const lost = signal<string | undefined>(undefined);
export const cameras = signal<(CameraEntry & { readAt: number })[]>([]);
export const counters = signal<ReadonlyMap<string, Counters>>(new Map());
export const thresholds = signal<Thresholds | undefined>(undefined);
export const clips = signal<ClipReport[]>([]);
export const detector = signal<DetectorEvent | undefined>(undefined);
/** Events that this page was too slow for. */
export const missed = signal(0);

/** The opened camera. It is part of the address, so that a link leads to it. */
export const opened = signal<string | undefined>(cameraOfAddress());
export const log = new FrameLog(MOST_FRAMES);
/** Grows a few times per second while there is something new to draw. */
export const tick = signal(0);
/** The frame that picture, ribbon and charts point at; undefined while they follow the newest. */
export const pointed = signal<number | undefined>(undefined);

/** Seconds between two frames, the latest ones by camera. The present silence does not count. */
const gaps = new Map<string, { at: number; last: number[] }>();

/** The usual time between two frames of a camera, seconds: the median of the last ones. */
export function usualGap(camera: string): number {
  const last = [...(gaps.get(camera)?.last ?? [])].sort((a, b) => a - b);
  return last[Math.floor(last.length / 2)] ?? 0;
}

export const samples = new Map<string, Sample[]>();
export const power: PowerSample[] = [];
/** The last hour of the opened camera in the intervals that the node stores. Frames that this page received follow. */
export const hour = signal<CameraSlot[]>([]);

export const thresholdSpec = computed(() => {
  const mine = thresholds.value?.cameras.find((camera) => camera.camera === opened.value);
  return mine?.threshold_spec ?? undefined;
});
export const thresholdInForce = computed(() => {
  const mine = thresholds.value?.cameras.find((camera) => camera.camera === opened.value);
  return mine?.threshold_spec ? (mine as Record<string, unknown>)[mine.threshold_spec.name] as number | undefined : undefined;
});

let dirty = false;
setInterval(() => {
  if (dirty && !document.hidden) {
    dirty = false;
    tick.value += 1;
  }
}, 200);

function cameraOfAddress(): string | undefined {
  return new URLSearchParams(location.hash.slice(1)).get("camera") ?? undefined;
}

addEventListener("hashchange", () => {
  const named = cameraOfAddress();
  if (named !== undefined && named !== opened.value) open(named);
});

export function open(camera: string): void {
  // The effects that follow the frames run later: until then nothing of the other camera may be drawn.
  if (camera !== opened.value) {
    log.clear();
    pointed.value = undefined;
  }
  opened.value = camera;
  history.replaceState(null, "", `#camera=${encodeURIComponent(camera)}`);
}

function takeCounters(message: Counters): void {
  const list = samples.get(message.camera) ?? [];
  samples.set(message.camera, list);
  const at = message.t_ns / 1e9;
  const before = list.at(-1);
  // The node restarted.
  if (before && message.frames < before.frames) list.length = 0;
  if (before && message.frames > before.frames) {
    const known = gaps.get(message.camera);
    const last = known ? [...known.last, (at - known.at) / (message.frames - before.frames)].slice(-9) : [];
    gaps.set(message.camera, { at, last });
  }
  const skipped = message.states.E + message.states.P - message.degraded_frames;
  list.push({ at, frames: message.frames, skipped, degraded: message.degraded_frames });
  if (list.length > MOST_SAMPLES) list.splice(0, MOST_SAMPLES / 10);
  if (message.camera === cameras.value[0]?.camera || cameras.value.length === 0) {
    power.push({ at, watts: Object.fromEntries(message.watts.map(({ domain, watts }) => [domain, watts])) });
    if (power.length > MOST_SAMPLES) power.splice(0, MOST_SAMPLES / 10);
  }
  counters.value = new Map(counters.value).set(message.camera, message);
  dirty = true;
}

function takeThreshold(message: Threshold): void {
  const known = thresholds.value;
  if (!known) return;
  thresholds.value = {
    ...known,
    cameras: known.cameras.map((entry) => (entry.camera === message.camera ? { ...entry, [message.threshold.name]: message.threshold.value } : entry)),
  };
}

function takeClip(report: ClipReport): void {
  clips.value = [report, ...clips.value].slice(0, MOST_CLIPS);
}

async function lookAtAll(): Promise<void> {
  const [kept, known, newest] = await Promise.all([
    json<Thresholds>("/api/v1/threshold"),
    json<{ cameras: CameraEntry[] }>("/api/v1/cameras"),
    json<{ clips: ClipReport[] }>(`/api/v1/clips?limit=${MOST_CLIPS}`),
  ]);
  thresholds.value = kept;
  takeCameras(known.cameras);
  clips.value = newest.clips;
  await lookAtNode();
}

/** Loads the node's power from before this page was opened. */
async function lookAtPower(): Promise<void> {
  const { slots, slot_s } = await json<PowerHistory>("/api/v1/power");
  const began = power[0]?.at ?? Date.now() / 1000;
  const before = slots
    .map((slot) => ({ at: slot.at_ms / 1000 + slot_s / 2, watts: slot.watts }))
    .filter((sample) => sample.at + slot_s / 2 <= began);
  power.unshift(...before);
  dirty = true;
}

/** Loads a camera's frames from before this page was opened. */
async function lookAtPast(camera: string, signal: AbortSignal): Promise<void> {
  const [history, known] = await Promise.all([
    json<CameraHistory>(`/api/v1/cameras/${encodeURIComponent(camera)}/history?frames=${MOST_PAST}`, { signal }),
    thresholds.value ?? json<Thresholds>("/api/v1/threshold", { signal }),
  ]);
  if (signal.aborted) return;
  const name = known.cameras.find((entry) => entry.camera === camera)?.threshold_spec?.name;
  log.unshift(past(history, name, Date.now() / 1000));
  hour.value = history.slots;
  dirty = true;
}

/** Reads the node's overview, and what depends on its policy. */
export async function lookAtNode(): Promise<void> {
  const before = overview.value?.uptime_s ?? 0;
  const now = await json<Overview>("/api/v1/node");
  if (now.uptime_s < before) {
    // The node restarted: its frames are different ones.
    log.clear();
    pointed.value = undefined;
    counters.value = new Map();
    samples.clear();
    power.length = 0;
    hour.value = [];
  }
  const switched = overview.value !== undefined && overview.value.policy !== now.policy;
  // Another policy has another threshold, and nothing may ask about that of the policy before.
  if (switched) thresholds.value = await json<Thresholds>("/api/v1/threshold");
  overview.value = now;
}

function takeCameras(known: CameraEntry[]): void {
  const readAt = performance.now();
  cameras.value = known.map((camera) => ({ ...camera, readAt }));
  if (!known.some((camera) => camera.camera === opened.value) && known[0]) opened.value = known[0].camera;
}

function onEvent(name: string, data: unknown): void {
  switch (name) {
    case "counters": return takeCounters(data as Counters);
    case "threshold": return takeThreshold(data as Threshold);
    case "clip": return takeClip(data as ClipReport);
    case "detector":
      detector.value = data as DetectorEvent;
      // Health follows the detector: show it without waiting for the next poll.
      void lookAtNode().catch(() => {});
      return;
    case "lagged":
      missed.value += (data as { lost: number }).lost;
      void lookAtAll().catch(() => {});
  }
}

/** Follows the node until aborted. */
export function watchNode(signal: AbortSignal): void {
  void follow({
    path: () => "/api/v1/events?types=counters,clip,threshold,detector",
    onEvent,
    onOpen: async () => {
      await lookAtAll();
      if (power.length < 60) await lookAtPower().catch(() => {});
      lost.value = undefined;
    },
    onLost: (reason) => {
      lost.value = reason;
    },
    signal,
  });
  void every(1000, signal, async () => {
    if (lost.value !== undefined || caller.value?.token_needed) return;
    const [known] = await Promise.all([json<{ cameras: CameraEntry[] }>("/api/v1/cameras"), lookAtNode()]);
    takeCameras(known.cameras);
  });
}

/** Follows the frames of one camera until aborted. */
export function watchFrames(camera: string, signal: AbortSignal): void {
  log.clear();
  pointed.value = undefined;
  hour.value = [];
  dirty = true;
  void follow({
    path: () => `/api/v1/events?camera=${encodeURIComponent(camera)}&types=frame,late`,
    onEvent: (name, data) => {
      // Another camera was opened while this one's event was on the way.
      if (signal.aborted) return;
      if (name === "late") log.finish(data as Frame);
      if (name !== "frame") return;
      log.push({ ...(data as Frame), at: Date.now() / 1000 });
      dirty = true;
      for (const listener of frameListeners) listener(data as Frame);
    },
    // Once: later frames are known, and a restarted node has no history.
    onOpen: () => {
      if (hour.value.length === 0) void lookAtPast(camera, signal).catch(() => {});
    },
    signal,
  });
}

/** Functions called at every frame of the opened camera. */
export const frameListeners = new Set<(frame: Frame) => void>();

/** The newest picture of a camera with the number of its frame. */
export async function picture(camera: string): Promise<{ seq: number; file: Blob }> {
  const response = await answer(`/api/v1/cameras/${encodeURIComponent(camera)}/frame.jpg`);
  return { seq: Number(response.headers.get("albireo-frame")), file: await response.blob() };
}

export interface Rates {
  perSecond: number;
  skipRate: number;
}

/** Frames per second and skip rate of a camera over the last `seconds`. */
export function rates(camera: string, seconds: number): Rates | undefined {
  const list = samples.get(camera);
  const last = list?.at(-1);
  if (!list || !last) return undefined;
  const first = list.find((sample) => sample.at >= last.at - seconds);
  if (!first || first === last) return undefined;
  const frames = last.frames - first.frames;
  return {
    perSecond: frames / (last.at - first.at),
    skipRate: frames ? (last.skipped - first.skipped) / frames : NaN,
  };
}
