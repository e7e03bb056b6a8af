// The picture with its boxes: the unchanged JPEG with boxes drawn by source. It can be paused and stepped through.

import { useEffect, useRef, useState } from "preact/hooks";
import { pause, Refused } from "../shared/api";
import { percent } from "../shared/format";
import { Section } from "../shared/parts";
import { CameraState, Help, NoPicture } from "./cameras";
import { describe, type Seen } from "./frames";
import { cameras, counters, frameListeners, log, opened, picture, pointed, tick } from "./store";
import type { BoxSource } from "./types";

const LINES: Record<BoxSource, { colour: string; dash: number[] }> = {
  detected: { colour: "#4fb3ff", dash: [] },
  predicted: { colour: "#6be28f", dash: [9, 6] },
  followed: { colour: "#d6e26b", dash: [14, 3] },
  rescued: { colour: "#ffb454", dash: [2, 4] },
};

/** Most pictures kept for stepping. */
const KEPT = 60;
/** Shortest time between two pictures, milliseconds. */
const LEAST_MS = 90;

interface Shown {
  seq: number;
  bitmap: ImageBitmap;
}

export function Picture() {
  const canvas = useRef<HTMLCanvasElement>(null);
  const kept = useRef<{ seq: number; file: Blob }[]>([]);
  const shown = useRef<Shown | undefined>(undefined);
  const [note, setNote] = useState("");
  const camera = opened.value;

  /** Takes the picture of another camera away, with all that was said of it. */
  const clear = () => {
    kept.current = [];
    shown.current?.bitmap.close();
    shown.current = undefined;
    setNote("");
    const place = canvas.current;
    place?.getContext("2d")?.clearRect(0, 0, place.width, place.height);
    place?.setAttribute("aria-label", `No picture of camera ${opened.value} yet`);
  };

  const paint = (frame: Seen | undefined, picture: Shown | undefined) => {
    const place = canvas.current;
    if (!place || (!frame && !picture)) return;
    draw(place, frame, picture?.bitmap);
    const words = frame ? describe(frame, Date.now() / 1000) : `frame ${picture!.seq}`;
    setNote(picture ? words : `${words} · this page has no picture of it`);
    const boxes = frame?.boxes.map((box) => `${box.class} ${percent(box.confidence, 0)} (${box.source})`).join(", ");
    place.setAttribute("aria-label", `Picture of camera ${opened.value}, ${words}${boxes ? `: ${boxes}` : ""}`);
  };

  const show = async (of: string | undefined, seq: number, file: Blob | undefined) => {
    const bitmap = file && (await createImageBitmap(file));
    const asked = pointed.value;
    // The user selected another camera or frame while it was decoded.
    if (of !== opened.value || (asked !== undefined && asked !== seq)) return bitmap?.close();
    shown.current?.bitmap.close();
    shown.current = bitmap ? { seq, bitmap } : undefined;
    paint(log.bySeq(seq), shown.current);
  };

  // New pictures, unless one is paused.
  useEffect(() => {
    clear();
    if (!camera) return;
    const stop = new AbortController();
    const came = () => new Promise<void>((done) => {
      const listener = () => {
        frameListeners.delete(listener);
        done();
      };
      frameListeners.add(listener);
      stop.signal.addEventListener("abort", listener);
    });
    const run = async () => {
      while (!stop.signal.aborted) {
        try {
          // A camera without frames has no picture.
          if (document.hidden || pointed.value !== undefined || !counters.value.get(camera)?.frames) {
            await pause(200, stop.signal);
            continue;
          }
          const began = performance.now();
          const got = await picture(camera);
          if (stop.signal.aborted) return;
          if (kept.current.at(-1)?.seq !== got.seq) {
            kept.current.push(got);
            if (kept.current.length > KEPT) kept.current.shift();
          }
          // The picture arrives before its frame is decided; wait, to show boxes and picture together.
          if (!log.bySeq(got.seq)) await Promise.race([came(), pause(400, stop.signal)]);
          if (pointed.value === undefined) await show(camera, got.seq, got.file);
          const rest = LEAST_MS - (performance.now() - began);
          if (rest > 0) await pause(rest, stop.signal);
          // Nothing new: wait a while for the next frame.
          if (log.at(log.length - 1)?.seq === got.seq) await Promise.race([came(), pause(2000, stop.signal)]);
        } catch (error) {
          await pause(error instanceof Refused ? 2000 : 1000, stop.signal);
        }
      }
    };
    void run();
    return () => stop.abort();
  }, [camera]);

  // The selected frame.
  const seq = pointed.value;
  useEffect(() => {
    if (seq === undefined) return;
    void show(camera, seq, kept.current.find((picture) => picture.seq === seq)?.file);
  }, [seq]);

  const step = (by: number) => {
    const from = pointed.value ?? shown.current?.seq;
    if (from === undefined) return;
    // Among the frames with a stored picture; the ribbon reaches further back.
    const places = kept.current.map((picture) => picture.seq);
    const at = places.indexOf(from);
    const next = at >= 0 ? places[at + by] : log.at(log.indexOf(from) + by)?.seq;
    if (next !== undefined) pointed.value = next;
  };
  const hold = () => {
    pointed.value = pointed.value === undefined ? shown.current?.seq : undefined;
  };
  const held = pointed.value !== undefined;
  const entry = cameras.value.find((entry) => entry.camera === camera);
  void tick.value;

  return (
    <Section
      id="picture"
      title={camera ? `Camera ${camera}` : "Picture"}
      aside={
        <div class="row controls" role="group" aria-label="Frames">
          <CameraState />
          <button type="button" class="plain" onClick={() => step(-1)} aria-label="One frame back">
            ◀
          </button>
          <button type="button" class="plain" onClick={hold} aria-pressed={held}>
            {held ? "Go on" : "Pause"}
          </button>
          <button type="button" class="plain" onClick={() => step(1)} disabled={!held} aria-label="One frame forward">
            ▶
          </button>
        </div>
      }
    >
      <div class="screen">
        <canvas id="canvas" ref={canvas} width={640} height={360} role="img" aria-label="No picture yet" />
        {note === "" && <NoPicture camera={entry} />}
      </div>
      <p class="under-picture" id="picture-note">
        {note}
      </p>
      {entry && <Help camera={entry} />}
      <ul class="legend">
        <li>
          <i class="line detected" /> detected in this frame
        </li>
        <li>
          <i class="line predicted" /> predicted, detector skipped
        </li>
        {log.newestFinal && (
          <li>
            <i class="line earlier" /> found by the detector in an earlier frame
          </li>
        )}
        <li>
          <i class="line followed" /> followed by optical flow
        </li>
        <li>
          <i class="line rescued" /> missed by the detector, kept
        </li>
      </ul>
    </Section>
  );
}

function draw(canvas: HTMLCanvasElement, frame: Seen | undefined, bitmap: ImageBitmap | undefined): void {
  const context = canvas.getContext("2d")!;
  // The node's history has no picture sizes.
  const width = bitmap?.width ?? (frame?.width || canvas.width);
  const height = bitmap?.height ?? (frame?.height || canvas.height);
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
    canvas.style.aspectRatio = `${width} / ${height}`;
  }
  if (bitmap) context.drawImage(bitmap, 0, 0);
  else {
    context.fillStyle = "#0b0e13";
    context.fillRect(0, 0, width, height);
  }
  // Lines and labels keep their size on the screen at every picture size.
  const unit = width / (canvas.clientWidth || width);
  context.lineWidth = 2 * unit;
  context.font = `600 ${11 * unit}px system-ui, sans-serif`;
  context.textBaseline = "bottom";
  // If frames are answered at once: the detector's boxes of a frame shortly before this one.
  const earlier = frame && log.newestFinal !== frame && frame.at - (log.newestFinal?.at ?? 0) < 2 ? log.newestFinal : undefined;
  context.lineWidth = unit;
  context.strokeStyle = "#4fb3ff99";
  context.setLineDash([]);
  for (const box of earlier?.boxes ?? []) {
    const [x1, y1, x2, y2] = box.box as [number, number, number, number];
    if (box.source === "detected") context.strokeRect(x1, y1, x2 - x1, y2 - y1);
  }
  context.lineWidth = 2 * unit;
  for (const box of frame?.boxes ?? []) {
    const { colour, dash } = LINES[box.source];
    const [x1, y1, x2, y2] = box.box as [number, number, number, number];
    context.strokeStyle = colour;
    context.setLineDash(dash.map((length) => length * unit));
    context.strokeRect(x1, y1, x2 - x1, y2 - y1);
    const label = `${box.class} ${percent(box.confidence, 0)}`;
    const tall = 15 * unit;
    const wide = context.measureText(label).width + 6 * unit;
    const top = y1 >= tall ? y1 - tall : y1;
    const left = Math.min(x1, width - wide);
    context.fillStyle = "#0b0e13cc";
    context.fillRect(left, top, wide, tall);
    context.fillStyle = colour;
    context.fillText(label, left + 3 * unit, top + tall - unit);
  }
}
