import { describe, expect, test } from "vitest";
import { certificates, count, duration, edp, joules, milliseconds, parsed, percent, short, small, typed, watts } from "../src/shared/format";

// Numbers are parted from their units by a narrow space.
const plain = (text: string) => text.replaceAll("\u202f", " ");

describe("numbers are written as people read them", () => {
  test("with the unit that fits", () => {
    expect(plain(joules(494.43))).toBe("494 J");
    expect(plain(joules(1_234))).toBe("1.23 kJ");
    expect(plain(joules(87_029_465))).toBe("87.0 MJ");
    expect(plain(watts(24.72))).toBe("24.7 W");
    expect(plain(milliseconds(0.2256))).toBe("0.226 ms");
    expect(plain(edp(49_438))).toBe("49.4 kJ·ms per frame");
  });

  test("a figure that is not there is no zero", () => {
    for (const write of [count, joules, watts, percent, duration, small, short, edp, milliseconds]) {
      expect(write(undefined)).toBe("–");
      expect(write(null)).toBe("–");
    }
    expect(percent(NaN)).toBe("–");
  });

  test("certificates with their end and the days left", () => {
    const now = Date.UTC(2027, 0, 1, 12);
    const ends = (day: number) => ({ name: "uplink.certificate", until_s: Date.UTC(2027, 0, day, 13) / 1000 });
    const said = (day: number) => certificates([ends(day)], now);
    expect(said(31)).toMatch(/^uplink.certificate until .*31.*2027 \(30 days\)$/);
    expect(said(2)).toMatch(/\(1 day\)$/);
    expect(said(-3)).toMatch(/^uplink.certificate ended on .*28.*2026$/);
    expect(certificates([], now)).toBe("");
  });

  test("times by their two largest units", () => {
    expect(plain(duration(3.21))).toBe("3.2 s");
    expect(plain(duration(59.9))).toBe("1 min");
    expect(plain(duration(200))).toBe("3 min 20 s");
    expect(plain(duration(3 * 3600 + 59))).toBe("3 h");
    expect(plain(duration(90_061))).toBe("1 d 1 h");
  });

  test("small values by a power of ten", () => {
    expect(small(3e-4)).toBe("3.0×10⁻⁴");
    expect(small(3e-4, 1)).toBe("3×10⁻⁴");
    expect(small(0.5)).toBe("0.5");
    expect(small(0)).toBe("0");
  });

  test("what is written can be typed and is the same number", () => {
    for (const value of [3e-4, 1e-9, 0.015, 1, 42, 1.23456e-5]) expect(parsed(typed(value))).toBe(value);
    expect(parsed("5,5e−4")).toBe(5.5e-4);
    for (const text of ["", "  ", "u", "1e", "1 2"]) expect(parsed(text)).toBeUndefined();
  });
});
