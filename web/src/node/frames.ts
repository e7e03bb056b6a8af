// Frames: what their states mean, why the detector ran, and the last ones of a camera.

import { knobValue } from "../shared/knob";
import { small } from "../shared/format";
import type { Detections, FrameState } from "./types";

/** A frame with when this page heard of it, seconds since the Unix epoch: a camera's own clock may be any. */
export type Seen = Detections & { at: number };

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

const BY_STATE = new Map(STATES.map((words) => [words.state, words]));

export function words(state: FrameState): StateWords {
  return BY_STATE.get(state)!;
}

export function skipped(frame: Pick<Detections, "state" | "degraded">): boolean {
  return (frame.state === "E" || frame.state === "P") && !frame.degraded;
}

/**
 * Why the detector ran on a frame, as far as the frame's own message tells: the state, and whether the largest
 * uncertainty had reached the threshold. Empty when it did not run.
 */
export function why(frame: Detections, knob: string): string {
  if (frame.degraded) return "the detector was needed and could not be had";
  if (!words(frame.state).ran) return "";
  if (frame.state === "E+I") return "the screen saw something";
  const limit = knob === "u" ? knobValue(frame, knob) : undefined;
  if (limit === undefined) return "the policy asked for it";
  const tau = frame.tau_max;
  if (tau === undefined || tau === null) return "no object was followed yet";
  return tau >= limit
    ? `uncertain: τ ${small(tau)} ≥ u ${small(limit)}`
    : `τ ${small(tau)} was below u ${small(limit)}: a cap or an audit asked`;
}

/** One line about a frame. */
export function describe(frame: Seen, knob: string, now: number): string {
  const { state, name } = words(frame.state);
  const age = Math.max(0, now - frame.at);
  const reason = why(frame, knob);
  const parts = [
    `frame ${frame.seq}`,
    `${age.toFixed(1)} s ago`,
    frame.degraded ? `${state}, degraded` : `${state}, ${name}`,
    ...(reason ? [reason] : []),
    `${frame.boxes.length} ${frame.boxes.length === 1 ? "box" : "boxes"}`,
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
    // In pieces: taking one from the front each time would move all the others each time.
    const over = this.#frames.length - this.most;
    if (over > Math.max(64, this.most / 10)) {
      for (const old of this.#frames.splice(0, over)) {
        if (this.#bySeq.get(old.seq) === old) this.#bySeq.delete(old.seq);
      }
      this.#gone += over;
    }
  }

  clear(): void {
    this.#frames = [];
    this.#bySeq.clear();
    this.#gone = 0;
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
