import { afterEach, beforeEach, describe, expect, test, vi } from "vitest";
import { csv, sorted, type Column } from "../src/shared/table";

// What of a browser the modules touch when they are loaded.
const kept = new Map<string, string>();
vi.stubGlobal("sessionStorage", {
  getItem: (key: string) => kept.get(key) ?? null,
  setItem: (key: string, value: string) => kept.set(key, value),
  removeItem: (key: string) => kept.delete(key),
});
vi.stubGlobal("location", { hash: "" });
vi.stubGlobal("history", { replaceState: (_: unknown, __: string, url: string) => (location.hash = url) });
vi.stubGlobal("addEventListener", () => {});
vi.stubGlobal("document", { hidden: false });

const { EventParser, follow } = await import("../src/shared/api");
const { frameAt, placeOf } = await import("../src/node/ribbon");
const { shownStates } = await import("../src/node/frames");
const { estimated, fromSlider, outside, toSlider, usefulRange } = await import("../src/node/threshold");
const { meaning } = await import("../src/node/screen");
const { offered } = await import("../src/node/policy");
const { graver } = await import("../src/node/log");
const { cameraState, shortFault, snippet } = await import("../src/node/cameras");
const { afterReturn } = await import("../src/hub/rollouts");
const { withGaps } = await import("../src/node/charts");
const { headline } = await import("../src/node/header");
const { href, parseRoute } = await import("../src/hub/route");
const { Rows, PAGE, path } = await import("../src/hub/rows");
const { LineParser, countOutcomes, request, terms } = await import("../src/hub/tune");
const { settingText } = await import("../src/hub/parts");
const { thresholdOf } = await import("../src/hub/fleet");
const { beginnings } = await import("../src/hub/energy");
const { hubState } = await import("../src/hub/store");

describe("the state of a hub", () => {
  test("says that it stores nothing, and why, before all else", () => {
    const reasons = { database: "the disk is full" };
    const faults = [["database", "the disk is full"]];
    expect(hubState({ isKnown: true, readiness: { ready: true, reasons: {} } })).toEqual({ mood: "good", word: "connected", faults: [] });
    expect(hubState({ isKnown: true, readiness: { ready: true, reasons } })).toEqual({ mood: "bad", word: "degraded", faults });
    expect(hubState({ isKnown: true, readiness: { ready: false, reasons } })).toEqual({ mood: "bad", word: "not ready", faults });
    expect(hubState({ lost: "the stream was refused", isKnown: false, readiness: { ready: false, reasons } }).word).toBe("not ready");
    expect(hubState({ lost: "it ended", isKnown: true }).word).toBe("hub does not answer");
    expect(hubState({ isKnown: false }).word).toBe("connecting");
  });
});

describe("event streams", () => {
  test("are read whatever the pieces they come in", () => {
    const text = 'event: frame\nid: 7\ndata: {"a":1}\n\n: keep-alive\n\nevent: clip\ndata: {"b":\ndata: 2}\n\nevent: cut';
    for (const size of [1, 2, 3, 7, 1000]) {
      const parser = new EventParser();
      const events = [];
      for (let at = 0; at < text.length; at += size) events.push(...parser.take(text.slice(at, at + size)));
      expect(events).toEqual([
        { name: "frame", id: "7", data: '{"a":1}' },
        { name: "clip", id: undefined, data: '{"b":2}' },
      ]);
    }
  });

  describe("that break", () => {
    beforeEach(() => void vi.useFakeTimers());
    afterEach(() => void vi.useRealTimers());

    test("are taken up again behind the last event", async () => {
      const asked: (string | null)[] = [];
      const stop = new AbortController();
      const got: unknown[] = [];
      vi.stubGlobal("fetch", async (_: string, init: { headers: Headers }) => {
        asked.push(init.headers.get("Last-Event-ID"));
        if (asked.length === 2) throw new TypeError("refused");
        return new Response(`event: node\nid: ${asked.length}\ndata: ${asked.length}\n\n`);
      });
      const done = follow({
        path: () => "/api/v1/events",
        onEvent: (_, data) => {
          got.push(data);
          if (got.length === 3) stop.abort();
        },
        signal: stop.signal,
      });
      await vi.advanceTimersByTimeAsync(20_000);
      await done;
      expect(asked).toEqual([null, "1", "1", "3"]);
      expect(got).toEqual([1, 3, 4]);
    });
  });
});

describe("the ribbon", () => {
  test("every place of it is one frame, and every frame one place", () => {
    const width = 37;
    const length = 100;
    const seen = new Set<number>();
    for (let row = 0; row < 4; row += 1) {
      for (let x = 0; x < width; x += 1) {
        const index = frameAt(x, row, width, length);
        if (index === undefined) continue;
        expect(placeOf(index, width, length)).toEqual({ x, row });
        seen.add(index);
      }
    }
    expect(seen.size).toBe(100);
    // A hundred frames fill three rows; the fourth is not drawn yet.
    expect(frameAt(width - 1, 2, width, length)).toBe(99);
    expect(frameAt(width - 1, 3, width, length)).toBeUndefined();
    expect(frameAt(-1, 0, width, length)).toBeUndefined();
    expect(placeOf(0, 10, 1000)).toBeUndefined();
  });
});

describe("the slider", () => {
  const range = usefulRange({ useful_minimum: 1e-4, useful_maximum: 1e-2 });
  test("covers what is of use, evenly in powers of ten", () => {
    expect(range).toEqual([1e-4, 1e-2]);
    expect(toSlider(1e-3, range)).toBe(100);
    expect(fromSlider(100, range)).toBe(1e-3);
    for (let place = 0; place <= 200; place += 1) expect(Math.abs(toSlider(fromSlider(place, range), range) - place)).toBeLessThanOrEqual(1);
  });
  test("stays at its ends for values outside of it", () => {
    expect(toSlider(1e-9, range)).toBe(0);
    expect(toSlider(1, range)).toBe(200);
  });
});

test("what a value would have skipped is read between the values that the node computed", () => {
  const curve = [{ value: 1e-4, skip_rate: 0.2 }, { value: 1e-3, skip_rate: 0.6 }, { value: 1e-2, skip_rate: 0.7 }];
  expect(estimated(curve, 1e-4)).toBeCloseTo(0.2, 12);
  expect(estimated(curve, 10 ** -3.5)).toBeCloseTo(0.4, 12);
  expect(estimated(curve, 1e-9)).toBe(0.2);
  expect(estimated(curve, 1)).toBe(0.7);
  expect(estimated([], 1e-3)).toBeUndefined();
  expect(estimated(curve, 0)).toBeUndefined();
});

test("lines of the log are chosen by how grave they are", () => {
  const lines = ["INFO", "WARN", "DEBUG", "ERROR"].map((level, number) => ({ number, level, at_ms: 0, target: "t", text: "" }));
  const levels = (least: string) => graver(lines, least).map((line) => line.level);
  expect(levels("all")).toEqual(["INFO", "WARN", "DEBUG", "ERROR"]);
  expect(levels("INFO")).toEqual(["INFO", "WARN", "ERROR"]);
  expect(levels("WARN")).toEqual(["WARN", "ERROR"]);
});

test("a camera is stale after two and a half seconds, or three of its own gaps", () => {
  expect(cameraState({ age: undefined, usualGap: 0 })).toBe("never seen");
  expect(cameraState({ age: 0.1, usualGap: 0.1 })).toBe("live");
  expect(cameraState({ age: 0.1, usualGap: 0.1, isDegraded: true })).toBe("degraded");
  expect(cameraState({ age: 2.6, usualGap: 0.1 })).toBe("stale");
  expect(cameraState({ age: 10, usualGap: 5 })).toBe("live");
  expect(cameraState({ age: 16, usualGap: 5, isDegraded: true })).toBe("stale");
});

test("a camera that is refused has failed, not only one that was never seen", () => {
  expect(cameraState({ age: undefined, usualGap: 0, fault: "failed: refused", source: "rtsp://a/b" })).toBe("failed");
  expect(cameraState({ age: 40, usualGap: 0.1, fault: "failed: refused", source: "rtsp://a/b" })).toBe("failed");
  expect(cameraState({ age: 0.1, usualGap: 0.1, fault: "failed: refused", source: "rtsp://a/b" })).toBe("live");
  expect(cameraState({ age: undefined, usualGap: 0, source: "rtsp://a/b" })).toBe("opening");
  expect(cameraState({ age: undefined, usualGap: 0, fault: "no frame has arrived since the start" })).toBe("never seen");
});

test("a camera of which no picture can be used says so, also if none was ever shown", () => {
  const fault = "the last 5 frames cannot be used: undecodable picture: no pixels";
  expect(cameraState({ age: undefined, usualGap: 0, fault, isUnusable: true })).toBe("unusable");
  expect(cameraState({ age: 0.1, usualGap: 0.1, fault, source: "rtsp://a/b", isUnusable: true })).toBe("unusable");
  expect(cameraState({ age: 0.1, usualGap: 0.1 })).toBe("live");
});

test("a fault is short, with the camera's address once and no word of the program that opens it", () => {
  const source = "rtsp://***@10.0.0.5/stream1";
  const refused = "failed: Impossible to open 'rtsp://***@10.0.0.5/stream1'; pipe:0: Connection refused; next attempt in 30 s";
  expect(shortFault(refused, source)).toBe("refused by 10.0.0.5, next try within 30 s");
  expect(shortFault("failed: 401 Unauthorized; next attempt in 0.5 s", source)).toBe("10.0.0.5 wants another user or password (401), next try within 0.5 s");
  expect(shortFault("failed: 503 Service Unavailable; next attempt in 2 s", source)).toBe("10.0.0.5 answers 503 Service Unavailable, next try within 2 s");
  expect(shortFault("failed: no picture for more than 15 s; next attempt in 4 s", source)).toBe("no picture for more than 15 s, next try within 4 s");
  expect(shortFault("failed: Failed to resolve hostname camera.local: Name or service not known; next attempt in 1 s", "rtsp://camera.local:554/s")).toBe("no address is known for camera.local:554, next try within 1 s");
  expect(shortFault("failed: something new at rtsp://***@10.0.0.5/stream1; and more", source)).toBe("something new at 10.0.0.5; and more");
  expect(shortFault("no frame for more than 30 s", undefined)).toBe("no frame for more than 30 s");
});

test("the states of a screen are shown only where there is one", () => {
  const states = (E: number, EI: number) => shownStates({ E, "E+I": EI }).map(({ state }) => state);
  expect(states(0, 0)).toEqual(["P", "I", "AI"]);
  expect(states(0, 3)).toEqual(["E", "P", "E+I", "I", "AI"]);
});

test("a value that cannot be set is told in words, with the range", () => {
  const spec = { name: "u", minimum: 1e-9, maximum: 1 };
  expect(outside("abc", spec)).toBe("“abc” is not a number: u is a number from 1e-9 to 1.");
  expect(outside(" ", spec)).toBe("Nothing was entered: u is a number from 1e-9 to 1.");
  expect(outside("7", spec)).toBe("7 is too large: u is a number from 1e-9 to 1.");
  expect(outside("-1", spec)).toBe("-1 is too small: u is a number from 1e-9 to 1.");
  expect(outside("5e-4", spec)).toBeUndefined();
});

describe("the address", () => {
  test("leads where it was made from", () => {
    const made = href(["nodes", "a/b c"], { search: "x&y", state: undefined, empty: "" });
    const found = parseRoute(made);
    expect(found.path).toEqual(["nodes", "a/b c"]);
    expect([...found.query]).toEqual([["search", "x&y"]]);
  });
  test("is the fleet without one", () => expect(parseRoute("").path).toEqual(["fleet"]));
});

describe("the rows of a fleet", () => {
  const filter = { state: "", search: "", select: "region=north", sort: "waiting", down: true };
  test("are asked for as the table shows them", () => {
    expect(path(filter, 200, 100)).toBe("/api/v1/nodes?select=region%3Dnorth&sort=waiting&down=true&offset=200&limit=100");
  });
  test("are held only near what is seen", async () => {
    vi.stubGlobal("fetch", async (address: string) => {
      const offset = Number(new URLSearchParams(address.split("?")[1]).get("offset"));
      const nodes = Array.from({ length: PAGE }, (_, index) => ({ node: `n${offset + index}` }));
      return Response.json({ total: 10_000, nodes });
    });
    let news = 0;
    const rows = new Rows(filter, () => (news += 1));
    for (let first = 0; first < 10_000; first += 50) {
      rows.want(first, first + 30);
      await vi.waitFor(() => expect(rows.at(first + 30)).toBeDefined(), { interval: 1 });
    }
    expect(rows.total).toBe(10_000);
    expect(rows.at(9_990)?.node).toBe("n9990");
    expect(rows.at(0)).toBeUndefined();
    expect(rows.held).toBeLessThanOrEqual(14);
    expect(news).toBe(100);
  });
});

describe("a setting given", () => {
  test("is for the terms that were written", () => {
    expect(terms(" cam-*, region=north & !cam-3 ,, all")).toEqual(["cam-*", "region=north & !cam-3", "all"]);
  });
  test("comes to outcomes, one a line", () => {
    const parser = new LineParser();
    expect(parser.take('{"node":"a","outcome":"app')).toEqual([]);
    const lines = parser.take('lied"}\n{"node":"b","outcome":"refused"}\n\n') as { outcome: string }[];
    expect(countOutcomes(lines)).toEqual({ applied: 1, refused: 1 });
  });
});

describe("a pause on an empty road", () => {
  test("is told in frames of the camera's rate, and says when it does nothing", () => {
    const front = { camera: "front", frames_per_second: 25, looks_at_one_in: 5 };
    expect(meaning(front, false)).toBe("one frame in 5 is looked at, at 25 frames/s");
    expect(meaning(front, true)).toMatch(/^front: /);
    expect(meaning({ ...front, frames_per_second: 5, looks_at_one_in: 1 }, false)).toContain("shorter than two frames");
    expect(meaning({ camera: "front", looks_at_one_in: 1 }, false)).toBe("no frames yet");
  });
});

describe("what is given", () => {
  test("goes where it belongs, though a threshold and a target have one name", () => {
    expect(request("skip_rate", 0.5)).toEqual({ path: "/api/v1/threshold", fields: { skip_rate: 0.5 } });
    expect(request("hold skip_rate", 0.5)).toEqual({ path: "/api/v1/target", fields: { target: { skip_rate: 0.5 } } });
    expect(request("hold nothing", undefined)).toEqual({ path: "/api/v1/target", fields: { target: null } });
    expect(request("hold watts", undefined)).toBeUndefined();
    expect(request("u", undefined)).toBeUndefined();
  });

  test("is shown as a value or as a target", () => {
    expect(settingText({ threshold: { name: "lambda", value: 0.5 } })).toBe("lambda = 0.5");
    expect(settingText({ target: { skip_rate: 0.5 } })).toBe("hold skip_rate = 0.5");
    expect(settingText({ target: null })).toBe("hold nothing");
    expect(settingText({ name: "u", value: 0.5 })).toBe("u = 0.5");
    expect(settingText(null)).toBe("–");
  });
});

test("a node's threshold is what its cameras have", () => {
  const camera = (value?: number) => ({ name: "front", state: "live", threshold: value && { name: "u", value }, threshold_source: "hub" });
  const node = (...cameras: object[]) => ({ status: { cameras } }) as never;
  expect(thresholdOf(node(camera(1e-4), camera(1e-4)))).toEqual({ name: "u", values: [1e-4] });
  expect(thresholdOf(node(camera(1e-4), camera(2e-4)))?.values).toHaveLength(2);
  expect(thresholdOf(node(camera()))).toBeUndefined();
  expect(thresholdOf(node())).toBeUndefined();
});

test("points of a chart begin where the hub's sums do and are over", () => {
  const span = { id: "day", words: "", step: 3_600_000, points: 24 };
  const times = beginnings(span, 1_795_307_277_759);
  expect(times).toHaveLength(24);
  expect(times.every((time) => time % 300_000 === 0)).toBe(true);
  expect(times[23]! + span.step).toBeLessThanOrEqual(1_795_307_277_759);
  expect(times[23]! + 2 * span.step).toBeGreaterThan(1_795_307_277_759);
});

describe("tables", () => {
  const column: Column<{ v?: number; t: string }> = { id: "v", head: "v", key: (row) => row.v, cell: () => null, unit: "J" };
  const words: Column<{ v?: number; t: string }> = { id: "t", head: "t", key: (row) => row.t, cell: () => null };
  test("what has no value comes last either way", () => {
    const rows = [{ t: "a" }, { v: 2, t: "b" }, { v: 10, t: "c" }];
    expect(sorted(rows, column, "ascending").map((row) => row.t)).toEqual(["b", "c", "a"]);
    expect(sorted(rows, column, "descending").map((row) => row.t)).toEqual(["c", "b", "a"]);
  });
  test("a file of them is CSV that no spreadsheet takes for formulas", () => {
    const text = csv([{ v: -1.5, t: 'say "hi", you' }, { t: "=1+1" }], [column, words]);
    expect(text).toBe('v (J),t\r\n-1.5,"say ""hi"", you"\r\n,\'=1+1\r\n');
  });
});

describe("the headline of a node's page", () => {
  const savings = { frames: 200, avoided_calls: 92, degraded_frames: 0 };
  const recall = { rate: 0.951, low: 0.91, high: 0.98 } as never;
  test("saving and recall are one sentence", () => {
    const text = headline(savings, undefined, recall).replaceAll("\u202f", " ");
    expect(text).toBe("46 % fewer detector calls; shows 95 % of what the detector would have found.");
    expect(headline(savings, "gate", recall)).toContain("; camera gate shows ");
  });
  test("a recall is named only once it is known within ten points to both sides", () => {
    for (const [low, high] of [[0.47, 0.98], [0.77, 0.97], [0.8, 0.99]]) {
      expect(headline(savings, undefined, { rate: 0.88, low, high, boxes: 8 } as never)).not.toContain("shows");
    }
    expect(headline(savings, undefined, { rate: 0.88, low: 0.79, high: 0.93, boxes: 300 } as never)).toContain("shows 88");
  });
  test("without an audit, without a frame and without a detector it promises nothing", () => {
    expect(headline(savings, undefined, undefined).replaceAll("\u202f", " ")).toBe("46 % fewer detector calls.");
    expect(headline({ ...savings, frames: 0 }, undefined, recall)).toBe("No frame yet.");
    expect(headline({ frames: 60, avoided_calls: 0, degraded_frames: 60 }, undefined, recall)).toBe("Every frame was answered without the detector it needed.");
  });
});

test("a chart's line ends where no frame came for long", () => {
  expect(withGaps([{ at: 1, seq: 1 }, { at: 2, seq: 2 }, { at: 40, seq: 3 }])).toEqual([{ at: 1, seq: 1 }, { at: 2, seq: 2 }, { at: 3 }, { at: 40, seq: 3 }]);
});

test("after a return no node is said to have the new value", () => {
  expect(afterReturn({ applied: 2, refused: 1 })).toEqual({ returned: 2, refused: 1 });
  expect(afterReturn({ untouched: 3 })).toEqual({ untouched: 3 });
});

test("the command to copy reaches the node where it listens", () => {
  const key = "albireo/node/front/frame";
  const plain = `albireo replay VIDEO.mp4 --loop --key ${key}`;
  expect(snippet(key, "tcp/127.0.0.1:7447", "car-7")).toBe(plain);
  expect(snippet(key, undefined, "car-7")).toBe(plain);
  expect(snippet(key, "tcp/127.0.0.1:7500", "car-7")).toBe(`${plain} --connect tcp/127.0.0.1:7500`);
  expect(snippet(key, "tcp/0.0.0.0:7447", "car-7")).toBe(`${plain} --connect tcp/car-7:7447`);
  expect(snippet(key, "tcp/[::]:7447", "car-7")).toBe(`${plain} --connect tcp/car-7:7447`);
});

test("one click offers the other of the two policies that are chosen between", () => {
  expect(["albireo", "vanilla", "expected-loss"].map(offered)).toEqual(["expected-loss", "expected-loss", "albireo"]);
});
