// Numbers as people read them, each with its unit.

const NONE = "–";
const THIN = "\u202f";
const plain = new Intl.NumberFormat("en");

export function count(value: number | undefined | null): string {
  return value === undefined || value === null ? NONE : plain.format(value);
}

/** `1.23 M`: for figures that would be too long. */
export function short(value: number | undefined | null): string {
  if (value === undefined || value === null) return NONE;
  const size = Math.abs(value);
  if (size < 100_000) return plain.format(Math.round(value));
  const [divisor, letter] = LARGE.find(([from]) => size >= from)!;
  return `${(value / divisor).toPrecision(3)}${THIN}${letter}`;
}

/** A share, 0 to 1, in percent. */
export function percent(share: number | undefined | null, digits = 1): string {
  return share === undefined || share === null || !Number.isFinite(share) ? NONE : `${(100 * share).toFixed(digits)}${THIN}%`;
}

function scaled(value: number, unit: string, steps: readonly [number, string][]): string {
  for (const [from, prefix] of steps) {
    if (Math.abs(value) >= from) return `${digits(value / from)}${THIN}${prefix}${unit}`;
  }
  return `${digits(value)}${THIN}${unit}`;
}

/** Three significant digits, without an exponent. */
function digits(value: number): string {
  const size = Math.abs(value);
  if (size === 0) return "0";
  if (size >= 100) return plain.format(Math.round(value));
  if (size >= 10) return value.toFixed(1);
  return value.toFixed(size >= 1 ? 2 : 3);
}

const LARGE: readonly [number, string][] = [
  [1e9, "G"],
  [1e6, "M"],
  [1e3, "k"],
];

export function joules(value: number | undefined | null): string {
  return value === undefined || value === null ? NONE : scaled(value, "J", LARGE);
}

export function watts(value: number | undefined | null): string {
  return value === undefined || value === null ? NONE : scaled(value, "W", LARGE);
}

export function milliseconds(value: number | undefined | null): string {
  return value === undefined || value === null ? NONE : `${digits(value)}${THIN}ms`;
}

/** Energy-delay product. */
export function edp(value: number | undefined | null): string {
  return value === undefined || value === null ? NONE : `${scaled(value, "J·ms", LARGE)} per frame`;
}

/** `3 h 20 min`: the two largest units. */
export function duration(seconds: number | undefined | null): string {
  if (seconds === undefined || seconds === null) return NONE;
  if (seconds < 10) return `${seconds.toFixed(1)}${THIN}s`;
  const whole = Math.round(seconds);
  if (whole < 60) return `${whole}${THIN}s`;
  const parts: [number, string][] = [
    [86_400, "d"],
    [3600, "h"],
    [60, "min"],
    [1, "s"],
  ];
  const first = parts.findIndex(([size]) => whole >= size);
  const [size, unit] = parts[first]!;
  const next = parts[first + 1];
  const head = `${Math.floor(whole / size)}${THIN}${unit}`;
  if (!next) return head;
  const rest = Math.floor((whole % size) / next[0]);
  return rest ? `${head} ${rest}${THIN}${next[1]}` : head;
}

export function ago(seconds: number): string {
  return seconds < 1 ? "now" : `${duration(seconds)} ago`;
}

const SUPERSCRIPT: Record<string, string> = {
  "-": "⁻", "0": "⁰", "1": "¹", "2": "²", "3": "³", "4": "⁴", "5": "⁵", "6": "⁶", "7": "⁷", "8": "⁸", "9": "⁹",
};

/** A threshold's value or an uncertainty: `3.0×10⁻⁴` where it is small, else as it is. */
export function small(value: number | undefined | null, precision = 2): string {
  if (value === undefined || value === null || !Number.isFinite(value)) return NONE;
  if (value === 0) return "0";
  if (Math.abs(value) >= 0.01 && Math.abs(value) < 1e5) return String(Number(value.toPrecision(3)));
  const [mantissa, exponent] = value.toExponential(precision - 1).split("e") as [string, string];
  const raised = [...String(Number(exponent))].map((character) => SUPERSCRIPT[character] ?? "").join("");
  return `${mantissa}×10${raised}`;
}

/** The same as people type it: `3e-4`. */
export function typed(value: number): string {
  if (value !== 0 && (Math.abs(value) < 0.01 || Math.abs(value) >= 1e5)) {
    const [mantissa, exponent] = Number(value.toPrecision(6)).toExponential().split("e") as [string, string];
    return `${mantissa}e${Number(exponent)}`;
  }
  return String(Number(value.toPrecision(6)));
}

/** The number that a text means; a decimal comma and a true minus sign are accepted. */
export function parsed(text: string): number | undefined {
  const trimmed = text.trim().replace("−", "-").replace(",", ".");
  const value = Number(trimmed);
  return trimmed !== "" && Number.isFinite(value) ? value : undefined;
}

const date = new Intl.DateTimeFormat(undefined, {
  month: "short", day: "numeric", hour: "2-digit", minute: "2-digit", second: "2-digit", hour12: false, timeZoneName: "short",
});

/** The zone of the times on this page, which is the reader's: `GMT+1`. */
export function zone(): string {
  return date.formatToParts(Date.now()).find(({ type }) => type === "timeZoneName")?.value ?? "";
}

/** A moment in the reader's zone, which is named. */
export function dateTime(ms: number | undefined | null): string {
  return ms === undefined || ms === null ? NONE : date.format(ms);
}

/** Until when certificates are valid: `uplink.certificate until 31 Jan 2027 (64 days)`. */
export function certificates(all: readonly { name: string; until_s: number }[], now = Date.now()): string {
  const words = all.map(({ name, until_s }) => {
    const days = Math.floor((until_s * 1000 - now) / 86_400_000);
    const until = new Date(until_s * 1000).toLocaleDateString([], { day: "numeric", month: "short", year: "numeric" });
    return days < 0 ? `${name} ended on ${until}` : `${name} until ${until} (${plural(days, "day")})`;
  });
  return words.join(", ");
}

/** A share with its 95 % confidence interval. */
interface Estimated {
  rate: number;
  low: number;
  high: number;
}

/** Half of the widest interval that is a figure. */
const CLEAR = 0.1;

/** Whether enough was compared to name a share. */
export function isClear(found: Estimated): boolean {
  return found.rate - found.low <= CLEAR && found.high - found.rate <= CLEAR;
}

export function interval(found: Estimated): string {
  return `${(100 * found.low).toFixed(0)} to ${(100 * found.high).toFixed(0)}\u202f%`;
}

/** The share, or only where it lies while little was compared. */
export function shareOrInterval(found: Estimated | undefined | null): string {
  return found && !isClear(found) ? interval(found) : percent(found?.rate);
}

export function plural(number: number, one: string, many = `${one}s`): string {
  return `${plain.format(number)} ${number === 1 ? one : many}`;
}
