// What was saved: the same sums as the hub makes, over the clips that the node remembers.

import type { ClipReport } from "./types";

export interface Saved {
  quality: string;
  clips: number;
  seconds: number;
  joules: number;
  /** Always an estimate: what the same clips would have cost with a detector call on every frame. */
  vanilla: number;
  /** Avoided calls that have no price, because their clip had no call or no energy: not in `vanilla`. */
  unpriced: number;
}

/** Detector calls avoided: frames answered without it, degraded ones not among them. */
export function avoided(clip: Pick<ClipReport, "states" | "degraded_frames">): number {
  return clip.states.E + clip.states.P - clip.degraded_frames;
}

/**
 * Energy by quality; sums of different qualities are never added. An avoided call is priced at the clip's own mean
 * power times its own mean detector time. Clips whose energy is not known in whole are left out.
 */
export function saved(clips: readonly ClipReport[]): Saved[] {
  const sums = new Map<string, Saved>();
  for (const clip of clips) {
    const { quality, joules, coverage } = clip.energy;
    if (joules === undefined || joules === null || coverage < 0.999 || clip.duration_s <= 0) continue;
    const sum = sums.get(quality) ?? { quality, clips: 0, seconds: 0, joules: 0, vanilla: 0, unpriced: 0 };
    sums.set(quality, sum);
    const calls = avoided(clip);
    sum.clips += 1;
    sum.seconds += clip.duration_s;
    sum.joules += joules;
    sum.vanilla += joules;
    if (clip.detector_latency_ms.count > 0) {
      sum.vanilla += (joules / clip.duration_s) * (clip.detector_latency_ms.mean / 1000) * calls;
    } else {
      sum.unpriced += calls;
    }
  }
  return [...sums.values()];
}
