// The live view of one node. The node sends counters and pictures only while this view is open.

import { useEffect, useRef, useState } from "preact/hooks";
import { answer, follow, messageOf, pause } from "../shared/api";
import { count, duration, percent, small, watts } from "../shared/format";
import { Fault, Figure, Quality, Section } from "../shared/parts";
import { heldText } from "../shared/target";
import type { CountersMessage, TargetReport } from "./types";

/** Shortest time between two pictures, milliseconds: they use the node's uplink. */
const PICTURE_MS = 2000;
/** Seconds over which rates are shown. */
const WINDOW = 30;

export interface Rate {
  perSecond: number;
  skipRate: number;
}

/** Frames per second and skip rate between the first and the last of some counters; undefined if the node restarted between them. */
export function rate(samples: readonly CountersMessage[]): Rate | undefined {
  const first = samples[0];
  const last = samples.at(-1);
  if (!first || !last || first === last) return undefined;
  const frames = last.frames - first.frames;
  const seconds = (last.t_ns - first.t_ns) / 1e9;
  if (frames < 0 || seconds <= 0) return undefined;
  const skipped = (message: CountersMessage) => message.states.E + message.states.P - message.degraded_frames;
  return { perSecond: frames / seconds, skipRate: frames ? (skipped(last) - skipped(first)) / frames : NaN };
}

export function Live({ node }: { node: string }) {
  const at = encodeURIComponent(node);
  const [cameras, setCameras] = useState<ReadonlyMap<string, CountersMessage[]>>(new Map());
  const [fault, setFault] = useState("");
  useEffect(() => {
    setCameras(new Map());
    setFault("");
    const stop = new AbortController();
    void follow({
      path: () => `/api/v1/nodes/${at}/live`,
      onOpen: () => setFault(""),
      onLost: setFault,
      onEvent: (name, data) => {
        if (name !== "counters") return;
        const message = data as CountersMessage;
        setCameras((known) => {
          const before = known.get(message.camera) ?? [];
          const restarted = (before.at(-1)?.frames ?? 0) > message.frames;
          return new Map(known).set(message.camera, [...(restarted ? [] : before), message].slice(-WINDOW));
        });
      },
      signal: stop.signal,
    });
    return () => stop.abort();
  }, [at]);
  return (
    <Section
      id="live"
      title="Now"
      wide
      aside={<span class="quiet">once per second, only while this page is open</span>}
    >
      <Fault text={fault} />
      {cameras.size === 0 && !fault && <p class="message quiet">Waiting for the node to send live data.</p>}
      <Held report={[...cameras.values()][0]?.at(-1)?.target} />
      <div class="live">
        {[...cameras].map(([camera, samples]) => (
          <Camera key={camera} path={`/api/v1/nodes/${at}/cameras/${encodeURIComponent(camera)}/frame.jpg?boxes=true`} samples={samples} />
        ))}
      </div>
    </Section>
  );
}

/** The target of the node, and its measured value. */
function Held({ report }: { report: TargetReport | null | undefined }) {
  if (!report?.target) return null;
  const { state, range } = report;
  return (
    <p class="message" id="held-now">
      Holds <b>{heldText(report.target)}</b>, now <b>{small(state?.actual)}</b>: {report.why ?? "starting"}. The threshold is{" "}
      <b>{small(state?.threshold)}</b>, allowed {small(range?.least)} to {small(range?.most)}.
      {state && state.unmet > 0 && ` Not met for ${duration(state.unmet_s)} in total.`}
    </p>
  );
}

function Camera({ path, samples }: { path: string; samples: CountersMessage[] }) {
  const last = samples.at(-1)!;
  const lately = rate(samples);
  const power = last.watts.find((entry) => entry.domain === "total") ?? last.watts[0];
  return (
    <div class="live-camera">
      <Newest path={path} camera={last.camera} />
      <dl class="figures">
        <Figure label={`frames of ${last.camera}`} note={lately && `${lately.perSecond.toFixed(1)} a second`}>
          {count(last.frames)}
        </Figure>
        <Figure label="skipped the detector" note={lately && `${percent(lately.skipRate)} over the last ${samples.length} s`}>
          {percent(last.frames ? last.skip_rate : undefined)}
        </Figure>
        {power && (
          <Figure label="power of the node" note={<Quality quality={last.power_quality} />}>
            {watts(power.watts)}
          </Figure>
        )}
        {last.degraded_frames > 0 && (
          <Figure label="answered without the detector">
            <span class="bad">{count(last.degraded_frames)}</span>
          </Figure>
        )}
      </dl>
    </div>
  );
}

/** The newest picture, loaded every two seconds while the page is visible. */
function Newest({ path, camera }: { path: string; camera: string }) {
  const [shown, setShown] = useState<string | undefined>(undefined);
  const [note, setNote] = useState("");
  const url = useRef<string | undefined>(undefined);
  useEffect(() => {
    const stop = new AbortController();
    const run = async () => {
      while (!stop.signal.aborted) {
        if (!document.hidden) {
          try {
            const file = await (await answer(path, { signal: stop.signal })).blob();
            if (stop.signal.aborted) return;
            if (url.current) URL.revokeObjectURL(url.current);
            url.current = URL.createObjectURL(file);
            setShown(url.current);
            setNote("");
          } catch (error) {
            if (stop.signal.aborted) return;
            setNote(messageOf(error));
            await pause(4 * PICTURE_MS, stop.signal);
          }
        }
        await pause(PICTURE_MS, stop.signal);
      }
    };
    void run();
    return () => {
      stop.abort();
      if (url.current) URL.revokeObjectURL(url.current);
      url.current = undefined;
      setShown(undefined);
    };
  }, [path]);
  return shown ? <img class="thumbnail" src={shown} alt={`Newest picture of camera ${camera}`} /> : <p class="message quiet">{note || "No picture yet."}</p>;
}
