// The ribbon: one pixel per frame, the newest at the right end of the lowest row.

import { useEffect, useRef, useState } from "preact/hooks";
import { plural } from "../shared/format";
import { Section } from "../shared/parts";
import { STATES, describe, shownStates, words } from "./frames";
import { counters, log, opened, pointed, tick } from "./store";

/** Most rows. The first is filled before the second begins. */
const MOST_ROWS = 4;
const HEIGHT = 22;
const GAP = 4;

/** Rows that so many frames fill. */
export function rowsOf(width: number, length: number): number {
  return Math.min(MOST_ROWS, Math.max(1, Math.ceil(length / width)));
}

/** The index of the frame drawn at a position; undefined if there is none. */
export function frameAt(x: number, row: number, width: number, length: number): number | undefined {
  const rows = rowsOf(width, length);
  const fromEnd = (rows - 1 - row) * width + (width - 1 - x);
  const index = length - 1 - fromEnd;
  return x >= 0 && x < width && row >= 0 && row < rows && index >= 0 ? index : undefined;
}

/** The position of a frame of the log. */
export function placeOf(index: number, width: number, length: number): { x: number; row: number } | undefined {
  const fromEnd = length - 1 - index;
  const row = rowsOf(width, length) - 1 - Math.floor(fromEnd / width);
  return row < 0 || fromEnd < 0 ? undefined : { x: width - 1 - (fromEnd % width), row };
}

export function Ribbon() {
  const canvas = useRef<HTMLCanvasElement>(null);
  const [hover, setHover] = useState<number | undefined>(undefined);
  const [width, setWidth] = useState(600);

  useEffect(() => {
    const observer = new ResizeObserver(() => setWidth(Math.max(100, Math.floor(canvas.current!.clientWidth))));
    observer.observe(canvas.current!);
    return () => observer.disconnect();
  }, []);

  const now = tick.value;
  const seq = pointed.value;
  useEffect(() => {
    const marked = seq === undefined ? undefined : log.indexOf(seq);
    draw(canvas.current!, width, marked === -1 ? undefined : marked);
  }, [now, width, seq]);

  const at = (event: MouseEvent) => {
    const rectangle = canvas.current!.getBoundingClientRect();
    const row = Math.floor((event.clientY - rectangle.top) / (HEIGHT + GAP));
    return frameAt(Math.floor(event.clientX - rectangle.left), row, width, log.length);
  };
  const onKey = (event: KeyboardEvent) => {
    const steps: Record<string, number> = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -width, ArrowDown: width, PageUp: -10, PageDown: 10 };
    if (event.key === "Escape" || event.key === "End") pointed.value = undefined;
    else if (event.key in steps) {
      const from = pointed.value === undefined ? log.length - 1 : log.indexOf(pointed.value);
      const next = log.at(Math.max(0, from + steps[event.key]!));
      pointed.value = next?.seq;
    } else return;
    event.preventDefault();
  };

  const named = seq === undefined ? undefined : log.bySeq(seq);
  const looked = (hover === undefined ? undefined : log.at(hover)) ?? named;
  const drawn = Math.min(log.length, MOST_ROWS * width);
  const first = log.at(log.length - drawn);
  const last = log.at(log.length - 1);
  const span = first && last ? last.at - first.at : 0;
  return (
    <Section
      id="ribbon"
      title="What happened to every frame"
      wide
      aside={<span class="quiet">{drawn ? `${plural(drawn, "frame")} over ${Math.round(span)} s, newest last` : "no frame yet"}</span>}
    >
      <canvas
        class="ribbon"
        ref={canvas}
        tabIndex={0}
        role="slider"
        aria-label="Frames, oldest to newest. Arrow keys select a frame, Escape clears the selection."
        aria-valuemin={0}
        aria-valuemax={Math.max(0, log.length - 1)}
        aria-valuenow={named ? log.indexOf(named.seq) : Math.max(0, log.length - 1)}
        aria-valuetext={looked ? describe(looked, Date.now() / 1000) : "newest frame"}
        onMouseMove={(event) => setHover(at(event))}
        onMouseLeave={() => setHover(undefined)}
        onClick={(event) => {
          const index = at(event);
          pointed.value = index === undefined ? undefined : log.at(index)?.seq;
        }}
        onKeyDown={onKey}
      />
      <p class="hovered">
        {looked
          ? describe(looked, Date.now() / 1000)
          : "Point at a pixel to see its frame and why the detector ran; click to select the frame."}
      </p>
      <ul class="legend">
        {shownStates(counters.value.get(opened.value ?? "")?.states).map(({ state, name, colour, ran }) => (
          <li key={state}>
            <i class={`block ${colour.slice(2)} ${ran ? "tall" : ""}`} /> <b>{state}</b> {name}
          </li>
        ))}
        <li>
          <i class="block degraded tall" /> degraded: detector not available
        </li>
      </ul>
    </Section>
  );
}

function draw(canvas: HTMLCanvasElement, width: number, marked: number | undefined): void {
  const scale = devicePixelRatio || 1;
  const rows = rowsOf(width, log.length);
  const height = rows * (HEIGHT + GAP) - GAP;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
    canvas.style.height = `${height}px`;
  }
  const context = canvas.getContext("2d")!;
  context.setTransform(scale, 0, 0, scale, 0, 0);
  const style = getComputedStyle(document.documentElement);
  const property = (name: string) => style.getPropertyValue(name).trim();
  const colours = new Map(STATES.map(({ state, colour }) => [state, property(colour)]));
  const bad = property("--bad");
  const ground = property("--ground");
  context.clearRect(0, 0, width, height);
  context.fillStyle = ground;
  for (let row = 0; row < rows; row += 1) context.fillRect(0, row * (HEIGHT + GAP), width, HEIGHT);
  for (let index = Math.max(0, log.length - rows * width); index < log.length; index += 1) {
    const frame = log.at(index)!;
    const { x, row } = placeOf(index, width, log.length)!;
    const top = row * (HEIGHT + GAP);
    if (frame.degraded) {
      // Distinct from the others: full height, dashed.
      context.fillStyle = bad;
      for (let y = 0; y < HEIGHT; y += 4) context.fillRect(x, top + y, 1, 2);
      continue;
    }
    // Frames that ran the detector are taller, so that the pattern does not depend on colour alone.
    const tall = words(frame.state).ran ? HEIGHT : HEIGHT / 2;
    context.fillStyle = colours.get(frame.state)!;
    context.fillRect(x, top + HEIGHT - tall, 1, tall);
  }
  const place = marked === undefined ? undefined : placeOf(marked, width, log.length);
  if (place) {
    context.strokeStyle = property("--text");
    context.lineWidth = 1;
    context.strokeRect(place.x - 2.5, place.row * (HEIGHT + GAP) + 0.5, 5, HEIGHT - 1);
  }
}
