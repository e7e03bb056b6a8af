// Knobs: the one number of a policy that is tuned while it runs.

/** The value of a knob that stands beside other fields under its own name. */
export function knobValue(message: object | null | undefined, name: string): number | undefined {
  const value = (message as Record<string, unknown> | null | undefined)?.[name];
  return typeof value === "number" ? value : undefined;
}
