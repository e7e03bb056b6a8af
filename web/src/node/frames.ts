// Frames: the meaning of their states, the causes of detector calls, and the last frames of a camera.

import { small } from "../shared/format";
import type { CallCause, CameraHistory, Detections, FrameState } from "./types";

/**
 * A frame with the time when this page received it, seconds since the Unix epoch, because camera clocks are not trusted.
 * For a frame answered before the page was opened, the node reports only the number of boxes.
 */
export type Seen = Detections & { at: number; pastBoxes?: number };

export interface StateWords {
  state: FrameState;
  /** A word for it. */
  name: string;
  /** What happened. */
  meaning: string;
  /** Name of the custom property with its colour. */
  colour: string;
  /** Whether the detector ran. */
  ran: boolean;
}

export const STATES: readonly StateWords[] = [
  { state: "E", name: "empty", meaning: "the screen saw an empty scene; detector skipped", colour: "--state-e", ran: false },
  { state: "P", name: "predicted", meaning: "boxes predicted; detector skipped", colour: "--state-p", ran: false },
  { state: "E+I", name: "screen, detector", meaning: "the screen saw something, so the detector ran", colour: "--state-ei", ran: true },
  { state: "I", name: "detector", meaning: "the detector ran", colour: "--state-i", ran: true },
  { state: "AI", name: "detector, rescue", meaning: "the detector ran, and an object it missed was kept", colour: "--state-ai", ran: true },
];

/** The states that a camera's frames can have: those of the screen only if there is one, that is, if it has ever decided a frame. */
export function shownStates(counts: { E: number; "E+I": number } | undefined): readonly StateWords[] {
  const screen = (counts?.E ?? 0) + (counts?.["E+I"] ?? 0) > 0;
  return screen ? STATES : STATES.filter(({ state }) => state !== "E" && state !== "E+I");
}

const BY_STATE = new Map(STATES.map((words) => [words.state, words]));

export function words(state: FrameState): StateWords {
  return BY_STATE.get(state)!;
}

export function skipped(frame: Pick<Detections, "state" | "degraded">): boolean {
  return (frame.state === "E" || frame.state === "P") && !frame.degraded;
}

export interface CauseWords {
  /** A few words for lists. */
  name: string;
  /** A clause for sentences. */
  meaning: string;
}

/** The causes of a detector call that a node reports. */
export const CAUSES: Record<CallCause, CauseWords> = {
  uncertain: { name: "uncertain", meaning: "an object became too uncertain" },
  new_object: { name: "new object", meaning: "a new object is not certain yet" },
  expected_loss: { name: "expected loss", meaning: "the boxes expected to be lost were worth a call" },
  object_cap: { name: "object's cap", meaning: "an object reached its longest time without the detector" },
  periodic_cap: { name: "periodic cap", meaning: "the camera reached its longest time without the detector" },
  screen: { name: "screen", meaning: "the screen saw something" },
  audit: { name: "audit", meaning: "the detector checks the screen by chance" },
  empty_limit: { name: "empty too long", meaning: "the screen had said “empty” too often in a row" },
  empty_road: { name: "empty road", meaning: "a pause had ended" },
  no_objects: { name: "no objects", meaning: "no object is tracked and no screen decides" },
  start: { name: "start", meaning: "the stream began" },
  retry: { name: "retry", meaning: "the detector had failed before" },
  changed: { name: "changed", meaning: "the picture changed" },
  schedule: { name: "schedule", meaning: "it was its turn" },
  every_frame: { name: "every frame", meaning: "the policy asks on every frame" },
  joined: { name: "joined", meaning: "a call was near, and the detector ran anyway for another camera" },
};

/** Why the detector was called on a frame, as its node says; empty when it was not. */
export function why(frame: Detections): string {
  let cause = "";
  if (frame.cause) cause = CAUSES[frame.cause]?.meaning ?? frame.cause;
  // A node of an older version does not report it.
  else if (words(frame.state).ran) cause = "the policy asked for it";
  if (frame.degraded) return cause ? `the detector was needed but not available: ${cause}` : "the detector was needed but not available";
  if (!cause) return "";
  const limit = frame.threshold?.name === "u" ? frame.threshold.value : undefined;
  const tau = frame.tau_max;
  const isOfTau = frame.cause === "uncertain" || frame.cause === "new_object";
  if (!isOfTau || limit === undefined || tau === undefined || tau === null) return cause;
  return `${cause}: τ ${small(tau)} ${tau >= limit ? "≥" : "<"} u ${small(limit)}`;
}

/** The past of a camera as frames, oldest first. `name` is that of the threshold of the policy in force. */
export function past(history: CameraHistory, name: string | undefined, now: number): Seen[] {
  const columns = history.frames;
  const first = columns.seq.length - history.of_policy;
  return columns.seq.map((seq, index) => {
    const detector = columns.detector_ms[index];
    const frame: Record<string, unknown> = {
      v: 1, seq, t_ns: 0, clip: "", width: 0, height: 0, boxes: [],
      at: now - columns.age_ms[index]! / 1000,
      state: columns.state[index]!,
      degraded: columns.degraded[index]!,
      cause: columns.cause[index] ?? undefined,
      tau_max: columns.tau_max[index] ?? undefined,
      pastBoxes: columns.boxes[index]!,
      latency_ms: { total: columns.total_ms[index] ?? 0, waiting: 0, policy: 0, ...(typeof detector === "number" ? { detector } : {}) },
    };
    const value = columns.threshold[index];
    if (name !== undefined && index >= first && typeof value === "number") frame.threshold = { name, value };
    return frame as unknown as Seen;
  });
}

/** One line about a frame. */
export function describe(frame: Seen, now: number): string {
  const { state, name } = words(frame.state);
  const age = Math.max(0, now - frame.at);
  const reason = why(frame);
  const boxes = frame.pastBoxes ?? frame.boxes.length;
  const parts = [
    `frame ${frame.seq}`,
    `${age.toFixed(1)} s ago`,
    frame.pending ? "predicted, detector at work" : `${state}, ${frame.degraded ? "degraded" : name}`,
    ...(reason ? [reason] : []),
    boxes === 1 ? "1 box" : `${boxes} boxes`,
    `${frame.latency_ms.total.toFixed(1)} ms`,
  ];
  return parts.join(" · ");
}

/** The last frames of a camera, oldest first, at most so many. */
export class FrameLog {
  #frames: Seen[] = [];
  #bySeq = new Map<number, Seen>();
  /** Frames that were pushed out: the first one kept has this place in all that came. */
  #gone = 0;

  /** The newest frame whose final answer came after its first one. */
  newestFinal: Seen | undefined;

  constructor(readonly most: number) {}

  get length(): number {
    return this.#frames.length;
  }

  get came(): number {
    return this.#gone + this.#frames.length;
  }

  push(frame: Seen): void {
    this.#frames.push(frame);
    this.#bySeq.set(frame.seq, frame);
    // In blocks: removing one from the front each time would move all the others.
    const over = this.#frames.length - this.most;
    if (over > Math.max(64, this.most / 10)) {
      for (const old of this.#frames.splice(0, over)) {
        if (this.#bySeq.get(old.seq) === old) this.#bySeq.delete(old.seq);
      }
      this.#gone += over;
    }
  }

  /** The final answer of a frame that was answered by prediction: it takes that answer's place. */
  finish(answer: Detections): void {
    const frame = this.#bySeq.get(answer.seq);
    if (!frame) return;
    Object.assign(frame, { pending: false, cause: undefined }, answer);
    this.newestFinal = frame;
  }

  /** Puts frames before those that are there, as far as they are older and there is room. */
  unshift(frames: readonly Seen[]): void {
    const known = new Set(this.#frames.slice(0, 512).map((frame) => frame.seq));
    const older = frames.filter((frame) => !known.has(frame.seq)).slice(-Math.max(0, this.most - this.#frames.length));
    for (const frame of older) if (!this.#bySeq.has(frame.seq)) this.#bySeq.set(frame.seq, frame);
    this.#frames = [...older, ...this.#frames];
  }

  clear(): void {
    this.#frames = [];
    this.#bySeq.clear();
    this.#gone = 0;
    this.newestFinal = undefined;
  }

  at(index: number): Seen | undefined {
    return this.#frames[index];
  }

  bySeq(seq: number): Seen | undefined {
    return this.#bySeq.get(seq);
  }

  indexOf(seq: number): number {
    const frame = this.#bySeq.get(seq);
    return frame ? this.#frames.lastIndexOf(frame) : -1;
  }

  last(number: number): Seen[] {
    return this.#frames.slice(-number);
  }
}

/** Percentile of some numbers by the nearest rank; undefined without any. */
export function percentile(values: readonly number[], share: number): number | undefined {
  if (values.length === 0) return undefined;
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[Math.min(sorted.length - 1, Math.max(0, Math.ceil(share * sorted.length) - 1))];
}
