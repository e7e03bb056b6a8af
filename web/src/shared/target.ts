// Targets instead of a fixed threshold.

import { small } from "./format";

/** The targets, each with its unit and an initial value. */
export const TARGETS = [
  { name: "skip_rate", words: "skip rate", unit: "of the frames", begin: "0.5" },
  { name: "recall", words: "recall against the detector, at least", unit: "", begin: "0.9" },
  { name: "watts", words: "power of the node", unit: "W", begin: "6" },
] as const;

export type TargetName = (typeof TARGETS)[number]["name"];

export interface HeldTarget {
  name: TargetName;
  value: number;
}

/** Name and value of a target, the only field of its message. */
export function nameAndValue(target: object | null | undefined): HeldTarget | undefined {
  const entry = Object.entries(target ?? {})[0];
  if (!entry) return undefined;
  const [name, value] = entry;
  return { name: name as TargetName, value: value as number };
}

/** `skip rate 0.5 of the frames`. */
export function heldText(target: object | null | undefined): string {
  const held = nameAndValue(target);
  if (!held) return "nothing";
  const about = TARGETS.find((one) => one.name === held.name);
  const unit = about?.unit ? ` ${about.unit}` : "";
  return `${about?.words ?? held.name} ${small(held.value)}${unit}`;
}
