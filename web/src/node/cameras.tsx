// All cameras as tiles: which are live, stale, never seen, degraded.

import { useEffect, useState } from "preact/hooks";
import { ago, count, percent } from "../shared/format";
import { CopyButton, Pill, Section, type Mood } from "../shared/parts";
import { cameras, counters, lost, open, opened, picture, rates, samples, tick, usualGap } from "./store";
import type { CameraEntry } from "./types";

/** A camera is stale when no frame came for this long, or three times as long as between its frames lately. */
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

export function Tiles() {
  // Ages grow by themselves.
  const [, setNow] = useState(0);
  useEffect(() => {
    const timer = setInterval(() => setNow((now) => now + 1), 1000);
    return () => clearInterval(timer);
  }, []);
  void tick.value;
  return (
    <Section id="cameras" title={cameras.value.length === 1 ? "Camera" : "Cameras"} wide>
      <ul class="tiles">
        {cameras.value.map((camera) => (
          <Tile key={camera.camera} camera={camera} />
        ))}
      </ul>
    </Section>
  );
}

function Tile({ camera }: { camera: CameraEntry & { readAt: number } }) {
  const message = counters.value.get(camera.camera);
  const lately = rates(camera.camera, 10);
  // What was read a while ago has aged since; frames counted since make it young again.
  const elapsed = (performance.now() - camera.readAt) / 1000;
  const known = camera.last_frame_age_s;
  const age = known === undefined || known === null ? undefined : lost.value === undefined ? known : known + elapsed;
  const word = cameraState(age, usualGap(camera.camera), degradedLately(camera.camera));
  const isOpen = opened.value === camera.camera;
  return (
    <li class={isOpen ? "tile open" : "tile"}>
      <button type="button" class="tile-button" aria-pressed={isOpen} onClick={() => open(camera.camera)}>
        {cameras.value.length > 1 && <Thumbnail camera={camera.camera} frames={camera.frames} />}
        <span class="tile-name">{camera.camera}</span>
        <Pill mood={MOODS[word]}>{word === "stale" && age !== undefined ? `stale, last picture ${ago(age)}` : word}</Pill>
        <span class="quiet">
          {word === "live" || word === "degraded"
            ? `last picture ${ago(age ?? 0)}` +
              (lately ? ` · ${lately.perSecond.toFixed(1)} frames/s · ${percent(lately.skipRate, 0)} skipped` : "")
            : `${count(message?.frames ?? camera.frames)} frames since the start`}
          {camera.width ? ` · ${camera.width}×${camera.height}` : ""}
        </span>
      </button>
      {camera.fault && <p class="fault bad">{camera.source ? `${camera.source} ${camera.fault}` : camera.fault}</p>}
      {word === "never seen" && camera.source && !camera.fault && <p class="fault quiet">Opening {camera.source} …</p>}
      {word === "never seen" && camera.key && (
        <div class="snippet">
          <p>
            No frame has come. Publish JPEG, PNG or raw pictures by Zenoh on the key <code>{camera.key}</code>, for example:
          </p>
          <pre tabIndex={0}>{snippet(camera.key)}</pre>
          <CopyButton text={snippet(camera.key)} />
        </div>
      )}
    </li>
  );
}

function degradedLately(camera: string): boolean {
  const list = samples.get(camera);
  const last = list?.at(-1);
  const first = list?.find((sample) => sample.at >= (last?.at ?? 0) - 10);
  return !!first && !!last && last.degraded > first.degraded;
}

/** A small picture, every two seconds while it can be seen. */
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
        // The tile says how the camera is.
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
