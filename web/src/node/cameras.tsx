// All cameras as tiles: those that need attention first, with the reason in a few words.

import type { ComponentChildren } from "preact";
import { useEffect, useState } from "preact/hooks";
import { ago, percent } from "../shared/format";
import { CopyButton, Pill, Section, type Mood } from "../shared/parts";
import { cameras, lost, open, opened, overview, picture, rates, samples, tick, usualGap } from "./store";
import type { CameraEntry } from "./types";

/** A camera is stale after this many seconds without a frame, or after three times its usual gap between frames if that is longer. */
const STALE_S = 2.5;

export type CameraWord = "failed" | "unusable" | "stale" | "degraded" | "never seen" | "opening" | "live";

/** What is known of a camera. */
export interface CameraFacts {
  /** Seconds since its last frame; undefined before the first. */
  age: number | undefined;
  /** Its usual seconds between two frames. */
  usualGap: number;
  isDegraded?: boolean;
  fault?: string | null | undefined;
  /** The address that the node opens. */
  source?: string | null | undefined;
  isUnusable?: boolean | undefined;
}

export function cameraState({ age, usualGap, isDegraded, fault, source, isUnusable }: CameraFacts): CameraWord {
  if (isUnusable) return "unusable";
  if (age === undefined && !source) return "never seen";
  const comes = age !== undefined && age <= Math.max(STALE_S, 3 * usualGap);
  if (!comes && fault && source) return "failed";
  if (!comes) return age === undefined ? "opening" : "stale";
  return isDegraded ? "degraded" : "live";
}

const MOODS: Record<CameraWord, Mood> = { live: "good", stale: "bad", failed: "bad", unusable: "bad", "never seen": "wait", opening: "wait", degraded: "bad" };

/** What needs attention first. */
const ORDER: CameraWord[] = ["failed", "unusable", "stale", "degraded", "never seen", "opening", "live"];

/** What a program or a camera says when a source fails, and what it means. `HOST` is the source's address. */
const FAILURES: [RegExp, string][] = [
  [/Connection refused/, "refused by HOST"],
  [/401|Unauthorized/, "HOST wants another user or password (401)"],
  [/403|Forbidden/, "HOST forbids it (403)"],
  [/404|Not Found/, "HOST has no such stream (404)"],
  [/([45]\d\d [A-Z][\w ]+)/, "HOST answers $1"],
  [/resolve hostname|Name or service not known|not known/, "no address is known for HOST"],
  [/No route to host|Network is unreachable|Host is down/, "HOST cannot be reached"],
  [/timed out|Timeout/i, "no answer from HOST"],
  [/(no picture for more than [\d.]+ s)/, "$1"],
  [/No such (file|device)/, "HOST is not there"],
  [/Permission denied/, "HOST may not be read"],
  [/Device or resource busy/, "HOST is used by another program"],
];

/** The failure in a few words, if it is one of those that are known. */
function knownFailure(reason: string, host: string): string | undefined {
  for (const [pattern, words] of FAILURES) {
    const found = pattern.exec(reason);
    if (found) return words.replace("$1", found[1] ?? "").replace("HOST", () => host);
  }
  return undefined;
}

/** `refused by 10.0.0.5, next try within 30 s`: a fault as short as it can be said; the whole text is where the camera is opened. */
export function shortFault(fault: string, source: string | null | undefined): string {
  const [, reason, seconds] = /^(?:failed: )?([^]*?)(?:; next attempt in ([\d.]+) s)?$/.exec(fault)!;
  // An address without what is before its host and behind its port; a file or device as it is.
  const host = source?.match(/^\w+:\/\/(?:[^@/]*@)?([^/?]+)/)?.[1] ?? source ?? "it";
  const known = knownFailure(reason!, host);
  const plain = source ? reason!.replaceAll("***@", "").replaceAll(source.replace("***@", ""), host) : reason!;
  return `${known ?? plain}${seconds ? `, next try within ${seconds} s` : ""}`;
}

/** The command that sends a video to a key. `endpoint` is where the node takes frames, and `host` where this page is from. */
export function snippet(key: string, endpoint: string | null | undefined, host: string): string {
  // An address of all interfaces is none to connect to.
  const place = endpoint?.replace(/\/(0\.0\.0\.0|\[::\])(?=:)/, () => `/${host}`);
  const connect = place && place !== "tcp/127.0.0.1:7447" ? ` --connect ${place}` : "";
  return `albireo replay VIDEO.mp4 --loop --key ${key}${connect}`;
}

/** Renders again every second, because ages grow. */
function useSeconds(): void {
  const [, setNow] = useState(0);
  useEffect(() => {
    const timer = setInterval(() => setNow((now) => now + 1), 1000);
    return () => clearInterval(timer);
  }, []);
}

/** Opens a camera, and brings its picture into view. */
function look(camera: string): void {
  open(camera);
  const picture = document.getElementById("picture");
  const { top = 0, bottom = 0 } = picture?.getBoundingClientRect() ?? {};
  // Half of it at least: what a click changed must be seen.
  if (top < 0 || (top + bottom) / 2 > innerHeight) picture?.scrollIntoView({ block: "start" });
}

export function Tiles() {
  useSeconds();
  void tick.value;
  const states = cameras.value.map((camera) => ({ camera, ...stateOf(camera) }));
  const ordered = states.sort((a, b) => ORDER.indexOf(a.word) - ORDER.indexOf(b.word));
  const bad = ordered.filter(({ word, camera }) => MOODS[word] === "bad" || (word !== "live" && camera.fault)).length;
  return (
    <Section
      id="cameras"
      title="Cameras"
      wide
      aside={<span class={bad ? "bad" : "quiet"}>{bad ? `${bad} of ${ordered.length} need attention` : `all ${ordered.length} in order`}</span>}
    >
      <ul class="tiles">
        {ordered.map((state) => (
          <Tile key={state.camera.camera} {...state} />
        ))}
      </ul>
    </Section>
  );
}

type Entry = CameraEntry & { readAt: number };

interface Stated {
  word: CameraWord;
  age: number | undefined;
  pill: ComponentChildren;
}

/** The state of a camera as a pill, and the age of its last picture. */
function stateOf(camera: Entry): Stated {
  // The age read earlier has grown since; newly counted frames reset it.
  const elapsed = (performance.now() - camera.readAt) / 1000;
  const known = camera.last_frame_age_s;
  let age: number | undefined;
  if (known !== undefined && known !== null) age = lost.value === undefined ? known : known + elapsed;
  const word = cameraState({
    age,
    usualGap: usualGap(camera.camera),
    isDegraded: degradedLately(camera.camera),
    fault: camera.fault,
    source: camera.source,
    isUnusable: camera.unusable,
  });
  return { word, age, pill: <Pill mood={MOODS[word]}>{word}</Pill> };
}

/** That a camera's picture has no news, in words. */
export function noNews({ cause, for_s }: { cause: string; for_s: number }): string {
  const length = for_s < 120 ? `${for_s.toFixed(0)} s` : `${(for_s / 60).toFixed(0)} min`;
  return `${cause === "dark" ? "dark, " : ""}no change for ${length}`;
}

function Tile({ camera, word, age, pill }: Stated & { camera: Entry }) {
  const lately = rates(camera.camera, 10);
  const isOpen = opened.value === camera.camera;
  const live = word === "live" || word === "degraded";
  // A live camera may still be slow, or send broken pictures; a failure that it has got over is no news.
  const isOver = live && camera.fault?.startsWith("failed: ");
  const fault = isOver || !camera.fault ? undefined : shortFault(camera.fault, camera.source);
  return (
    <li class={isOpen ? "tile open" : "tile"}>
      <button type="button" class="tile-button" aria-pressed={isOpen} title={camera.fault ?? undefined} onClick={() => look(camera.camera)}>
        <Thumbnail camera={camera.camera} frames={camera.frames} />
        <span class="tile-name">{camera.camera}</span>
        {pill}
        {fault && <span class="bad">{fault}</span>}
        {live && lately && (
          <span class="quiet">
            {lately.perSecond.toFixed(1)}
            {camera.rate && camera.rate > 1.1 * lately.perSecond ? ` of ${camera.rate.toFixed(1)}` : ""} frames/s · {percent(lately.skipRate, 0)} skipped
          </span>
        )}
        {live && camera.no_news && <span class="quiet">{noNews(camera.no_news)}</span>}
        {!live && (age !== undefined || !fault) && <span class="quiet">{age === undefined ? "no picture yet" : `last picture ${ago(age)}`}</span>}
      </button>
    </li>
  );
}

/** The state of the opened camera, beside its picture. */
export function CameraState() {
  useSeconds();
  const camera = cameras.value.find(({ camera }) => camera === opened.value);
  if (!camera) return null;
  const { word, age, pill } = stateOf(camera);
  return (
    <>
      {pill}
      {age !== undefined && (word === "stale" || word === "failed") && <span class="quiet">last picture {ago(age)}</span>}
    </>
  );
}

/** In the place of a picture: why there is none. */
export function NoPicture({ camera }: { camera: CameraEntry | undefined }) {
  if (!camera) return <p class="no-picture">No picture yet.</p>;
  return (
    <p class="no-picture">
      No picture of {camera.camera} yet{camera.fault && (camera.source || camera.unusable) ? `: ${shortFault(camera.fault, camera.source)}` : "."}
    </p>
  );
}

/** The fault of a camera in full, or how to send it pictures. */
export function Help({ camera }: { camera: CameraEntry }) {
  const seen = camera.last_frame_age_s !== undefined && camera.last_frame_age_s !== null;
  if (camera.fault && (camera.source || seen || camera.unusable)) {
    // ffmpeg names the address, too, with a mask where its credentials were.
    const named = !camera.source || camera.fault.replaceAll("***@", "").includes(camera.source);
    return <p class="fault bad">{named ? camera.fault : `${camera.source} ${camera.fault}`}</p>;
  }
  if (seen) return null;
  if (camera.source) return <p class="fault quiet">Opening {camera.source} …</p>;
  if (!camera.key) return null;
  const command = snippet(camera.key, overview.value?.frames_at, location.hostname);
  return (
    <div class="snippet">
      <p>
        Set <code>source = "rtsp://…"</code> for this camera in the node's configuration, or publish JPEG, PNG or raw pictures on the Zenoh
        key <code>{camera.key}</code>. For example:
      </p>
      <pre tabIndex={0}>{command}</pre>
      <CopyButton text={command} />
    </div>
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
    let over = false;
    const show = async () => {
      if (document.hidden) return;
      try {
        const { file } = await picture(camera);
        if (over) return;
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
      over = true;
      clearInterval(timer);
      if (current) URL.revokeObjectURL(current);
    };
  }, [camera, seen]);
  return address ? <img class="thumbnail" src={address} alt="" /> : <span class="thumbnail" />;
}
