// Tables: sorting, and rows as CSV (RFC 4180).

import type { ComponentChildren } from "preact";

export interface Column<T> {
  id: string;
  head: string;
  /** The value for sorting and for the file; undefined if there is none. */
  key: (row: T) => number | string | undefined;
  cell: (row: T) => ComponentChildren;
  unit?: string;
  /** Text, not numbers. */
  left?: boolean;
}

/** The order of a table, in the words of `aria-sort`. */
export type Order = "descending" | "ascending";

/** Sorted by a column; rows without a value come last in both orders. */
export function sorted<T>(rows: readonly T[], column: Column<T>, order: Order): T[] {
  return [...rows].sort((a, b) => {
    const x = column.key(a);
    const y = column.key(b);
    if (x === undefined && y === undefined) return 0;
    if (x === undefined) return 1;
    if (y === undefined) return -1;
    const difference = typeof x === "number" && typeof y === "number" ? x - y : String(x).localeCompare(String(y));
    return order === "descending" ? -difference : difference;
  });
}

/** The mark of an order behind the head of its column. */
export function arrow(order: Order): string {
  return order === "descending" ? " ▾" : " ▴";
}

function field(value: number | string | undefined): string {
  let text = value === undefined ? "" : String(value);
  // A spreadsheet would treat it as a formula.
  if (typeof value === "string" && /^[=+\-@\t\r]/.test(text)) text = `'${text}`;
  return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

export function csv<T>(rows: readonly T[], columns: readonly Column<T>[]): string {
  const head = columns.map((column) => field(column.unit ? `${column.id} (${column.unit})` : column.id));
  const lines = rows.map((row) => columns.map((column) => field(column.key(row))));
  return [head, ...lines].map((line) => `${line.join(",")}\r\n`).join("");
}
