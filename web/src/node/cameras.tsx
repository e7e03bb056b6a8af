// All cameras as tiles, each live, stale, degraded or never seen.

import type { ComponentChildren } from "preact";
import { useEffect, useState } from "preact/hooks";
import { ago, percent } from "../shared/format";
import { CopyButton, Pill, Section, type Mood } from "../shared/parts";
import { cameras, lost, open, opened, picture, rates, samples, tick, usualGap } from "./store";
import type { CameraEntry } from "./types";

/** A camera is stale after this many seconds without a frame, or after three times its usual gap between frames if that is longer. */
const STALE_S = 2.5;

export type CameraWord = "live" | "stale" | "never seen" | "degraded";

export function cameraState(age: number | undefined, usualGap: number, degradedLately: boolean): CameraWord {
  if (age === undefined) return "never seen";
  if (age > Math.max(STALE_S, 3 * usualGap)) return "stale";
  return degradedLately ? "degraded" : "live";
}

const MOODS: Record<CameraWord, Mood> = { live: "good", stale: "bad", "never seen": "wait", degraded: "bad" };

function snippet(key: string): string {
  return `albireo replay VIDEO.mp4 --loop --key ${key}`;
}

/** Renders again every second, because ages grow. */
function useSeconds(): void {
  const [, setNow] = useState(0);
  useEffect(() => {
    const timer = setInterval(() => setNow((now) => now + 1), 1000);
    return () => clearInterval(timer);
  }, []);
}

export function Tiles() {
  useSeconds();
  void tick.value;
  return (
    <Section id="cameras" title="Cameras" wide>
      <ul class="tiles">
        {cameras.value.map((camera) => (
          <Tile key={camera.camera} camera={camera} />
        ))}
      </ul>
    </Section>
  );
}

type Entry = CameraEntry & { readAt: number };

/** The state of a camera as a pill, and the age of its last picture. */
function stateOf(camera: Entry): { word: CameraWord; age: number | undefined; pill: ComponentChildren } {
  // The age read earlier has grown since; newly counted frames reset it.
  const elapsed = (performance.now() - camera.readAt) / 1000;
  const known = camera.last_frame_age_s;
  const age = known === undefined || known === null ? undefined : lost.value === undefined ? known : known + elapsed;
  const word = cameraState(age, usualGap(camera.camera), degradedLately(camera.camera));
  return { word, age, pill: <Pill mood={MOODS[word]}>{word}</Pill> };
}

function Tile({ camera }: { camera: Entry }) {
  const { word, age, pill } = stateOf(camera);
  const lately = rates(camera.camera, 10);
  const isOpen = opened.value === camera.camera;
  const live = word === "live" || word === "degraded";
  return (
    <li class={isOpen ? "tile open" : "tile"}>
      <button type="button" class="tile-button" aria-pressed={isOpen} onClick={() => open(camera.camera)}>
        <Thumbnail camera={camera.camera} frames={camera.frames} />
        <span class="tile-name">{camera.camera}</span>
        {pill}
        <span class="quiet">
          {live && lately
            ? `${lately.perSecond.toFixed(1)} frames/s · ${percent(lately.skipRate, 0)} skipped`
            : age === undefined
              ? "no picture yet"
              : `last picture ${ago(age)}`}
        </span>
      </button>
      <Help camera={camera} folded />
    </li>
  );
}

/** The state of the only camera, beside its picture. */
export function OnlyCamera() {
  useSeconds();
  const camera = cameras.value[0];
  if (cameras.value.length !== 1 || !camera) return null;
  const { word, age, pill } = stateOf(camera);
  return (
    <>
      {pill}
      {word === "stale" && <span class="quiet">last picture {ago(age ?? 0)}</span>}
    </>
  );
}

/** The fault of a camera, or how to send it pictures. */
export function Help({ camera, folded = false }: { camera: CameraEntry; folded?: boolean }) {
  const seen = camera.last_frame_age_s !== undefined && camera.last_frame_age_s !== null;
  const command = snippet(camera.key ?? "");
  const help = (
    <>
      <p>
        Publish JPEG, PNG or raw pictures on the Zenoh key <code>{camera.key}</code>, for example:
      </p>
      <pre tabIndex={0}>{command}</pre>
      <CopyButton text={command} />
    </>
  );
  if (camera.fault && (camera.source || seen)) return <p class="fault bad">{camera.source ? `${camera.source} ${camera.fault}` : camera.fault}</p>;
  if (seen) return null;
  if (camera.source) return <p class="fault quiet">Opening {camera.source} …</p>;
  if (!camera.key) return null;
  return folded ? (
    <details class="snippet">
      <summary>How to send it pictures</summary>
      {help}
    </details>
  ) : (
    <div class="snippet">{help}</div>
  );
}

function degradedLately(camera: string): boolean {
  const list = samples.get(camera);
  const last = list?.at(-1);
  const first = list?.find((sample) => sample.at >= (last?.at ?? 0) - 10);
  return !!first && !!last && last.degraded > first.degraded;
}

/** A small picture, reloaded every two seconds while it is visible. */
function Thumbnail({ camera, frames }: { camera: string; frames: number }) {
  const [address, setAddress] = useState("");
  const seen = frames > 0;
  useEffect(() => {
    if (!seen) return;
    let current = "";
    const show = async () => {
      if (document.hidden) return;
      try {
        const { file } = await picture(camera);
        const next = URL.createObjectURL(file);
        setAddress(next);
        if (current) URL.revokeObjectURL(current);
        current = next;
      } catch {
        // The tile shows the camera's state.
      }
    };
    void show();
    const timer = setInterval(show, 2000);
    return () => {
      clearInterval(timer);
      if (current) URL.revokeObjectURL(current);
    };
  }, [camera, seen]);
  return address ? <img class="thumbnail" src={address} alt="" /> : <span class="thumbnail" />;
}
