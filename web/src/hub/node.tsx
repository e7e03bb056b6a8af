// One node of the fleet: its health, its energy, its clips and settings.

import { answer, messageOf } from "../shared/api";
import { certificates, count, dateTime, duration, edp, joules, milliseconds, percent, small, ago } from "../shared/format";
import { isPage, Pill, Quality, Section, whyNot } from "../shared/parts";
import { heldText } from "../shared/target";
import { Download, Fault, Setting, Outcomes, Presence, Saved, useLoaded } from "./parts";
import { Live } from "./live";
import { href } from "./route";
import { selected } from "./fleet";
import { Tune } from "./tune";
import { useEffect, useState } from "preact/hooks";
import type { Revision, Energy, NodeDetail, StoredClip, TargetStatus } from "./types";

const WEEK_MS = 7 * 86_400_000;

/** Why the threshold has its value. */
const TARGET_STATUS: Record<TargetStatus, string> = {
  measuring: "not enough data yet",
  moving: "not reached yet",
  held: "the target is held",
  more_than_kept: "exceeded, at the end of the threshold's range",
  cannot_be_met: "cannot be met within the threshold's range",
  no_frames: "no frames arrive",
  no_power: "the node has no power figures",
  no_audit: "no frames are audited",
};

function setBy(source: string): string {
  return source === "hub" ? "the hub" : source === "local" ? "a local change" : "its configuration";
}

export function Node({ name }: { name: string }) {
  const at = encodeURIComponent(name);
  const node = useLoaded<NodeDetail>(`/api/v1/nodes/${at}`, 3000);
  const since = Math.floor((Date.now() - WEEK_MS) / 3_600_000) * 3_600_000;
  const energy = useLoaded<Energy>(`/api/v1/energy?by=threshold&node=${at}&since_ms=${since}`, 30_000);
  const clips = useLoaded<{ clips: StoredClip[] }>(`/api/v1/clips?node=${at}&limit=30`, 10_000);
  const given = useLoaded<{ revisions: Revision[] }>(`/api/v1/revisions?node=${at}&limit=10`, 10_000);
  // Settings on this page apply to this node.
  useEffect(() => {
    selected.value = new Set([name]);
    return () => {
      selected.value = new Set();
    };
  }, [name]);
  const is = node.value;
  const status = is?.status;
  return (
    <>
      <Section
        id="node"
        title={name}
        wide
        aside={
          <span>
            {isPage(status?.labels?.page) && (
              <>
                <a href={status.labels.page}>its own page</a>
                {" · "}
              </>
            )}
            <a href={href(["fleet"])}>all nodes</a>
          </span>
        }
      >
        <Fault text={node.fault} />
        {is && (
          <>
            <p class="message">
              <Presence state={is.state} /> since {dateTime(is.since_ms)}
              {is.why ? `: ${is.why}` : ""}
              <span class="quiet"> · heard {is.heard_ms ? ago(Math.max(0, (Date.now() - is.heard_ms) / 1000)) : "never"}</span>
            </p>
            <dl class="pairs">
              <dt>policy, model</dt>
              <dd>{status ? `${status.policy}, ${status.model}` : "–"}</dd>
              <dt>runs on</dt>
              <dd>{status?.provider ?? "–"}</dd>
              <dt>power figures</dt>
              <dd>
                {status?.power_source ?? "–"} {status && <Quality quality={status.power_quality} />}
              </dd>
              <dt>reports waiting</dt>
              <dd>
                {count(is.waiting)}
                {status && !status.outbox.durable ? ", in memory only" : ""}
                {status && status.outbox.lost > 0 ? <span class="bad">{`, ${count(status.outbox.lost)} lost`}</span> : ""}
              </dd>
              {status?.certificates && status.certificates.length > 0 && (
                <>
                  <dt>certificates</dt>
                  <dd>{certificates(status.certificates)}</dd>
                </>
              )}
              <dt>labels</dt>
              <dd>{Object.entries(status?.labels ?? {}).map(([key, value]) => `${key}=${value}`).join(", ") || "none"}</dd>
              <dt>version</dt>
              <dd>{status?.version ?? "–"}</dd>
              {status?.refused && (
                <>
                  <dt>refused</dt>
                  <dd class="bad">{status.refused.reason}</dd>
                </>
              )}
            </dl>
            {["silent", "offline"].includes(is.state) && <Forget name={name} />}
            {status?.target && (
              <p class="message" id="held">
                Holds <b>{heldText(status.target.target)}</b>
                {typeof status.target.actual === "number" && <>, <b>{small(status.target.actual)}</b> at its last report</>}:{" "}
                {status.target.status ? TARGET_STATUS[status.target.status] : "starting"}; set by {setBy(status.target.source)}.
              </p>
            )}
            {status?.target_off && <p class="message wait" id="held">Holds no target any more: {status.target_off}.</p>}
            <h3>Cameras</h3>
            <ul class="tiles">
              {(status?.cameras ?? []).map((camera) => {
                const { name: camera_name, state, threshold, threshold_source } = camera;
                return (
                  <li class="tile padded" key={String(camera_name)}>
                    <b>{String(camera_name)}</b>{" "}
                    <Pill mood={state === "live" ? "good" : state === "stale" ? "bad" : "wait"}>{String(state).replace("_", " ")}</Pill>
                    <br />
                    <span class="quiet">
                      <Setting value={threshold} />
                      {status?.target ? ", moved by its target" : `, set by ${setBy(threshold_source)}`}
                    </span>
                  </li>
                );
              })}
            </ul>
          </>
        )}
      </Section>
      {is && <Live key={name} node={name} />}
      <Section id="node-energy" title="Energy of the last seven days, by policy and value" wide>
        <Fault text={energy.fault} />
        <EnergyTable energy={energy.value} />
      </Section>
      <Tune />
      <Section
        id="clips"
        title="Clips"
        wide
        aside={<Download path={`/api/v1/clips.csv?node=${at}`} name={`clips-${name}.csv`}>Download all as CSV</Download>}
      >
        <Fault text={clips.fault} />
        <div class="scroll" tabIndex={0} role="group" aria-label="table of clips">
          <table>
            <thead>
              <tr>
                {["began", "camera", "clip"].map((head) => <th key={head} scope="col" class="left">{head}</th>)}
                {["frames", "skipped", "length", "energy", "EDP", "energy is", "latency mean", "p99", "detector mean", "threshold"].map((head) => (
                  <th key={head} scope="col">{head}</th>
                ))}
              </tr>
            </thead>
            <tbody>
              {(clips.value?.clips ?? []).map((clip) => (
                <tr key={clip.id}>
                  <td class="left">{dateTime(clip.at_ms)}</td>
                  <td class="left">{clip.camera}</td>
                  <td class="left">{clip.clip}</td>
                  <td>{count(clip.frames)}</td>
                  <td>{percent(clip.frames ? (clip.e + clip.p - clip.degraded) / clip.frames : undefined)}</td>
                  <td>{duration(clip.duration_s)}</td>
                  <td>{joules(clip.joules)}</td>
                  <td>{edp(clip.edp)}</td>
                  <td><Quality quality={clip.quality} /></td>
                  <td>{milliseconds(clip.latency_mean_ms)}</td>
                  <td>{milliseconds(clip.latency_p99_ms)}</td>
                  <td>{milliseconds(clip.detector_mean_ms)}</td>
                  <td>{clip.threshold ? `${clip.threshold} = ${small(clip.value)}` : "–"}</td>
                </tr>
              ))}
            </tbody>
          </table>
        </div>
      </Section>
      <Section id="reports" title="Reports">
        <dl class="pairs">
          <dt>stored</dt>
          <dd>{count(is?.reports?.stored ?? 0)}</dd>
          <dt>missing</dt>
          <dd class={is?.reports?.missing ? "bad" : ""}>{count(is?.reports?.missing ?? 0)}</dd>
          <dt>set aside</dt>
          <dd class={is?.reports?.set_aside ? "bad" : ""}>{count(is?.reports?.set_aside ?? 0)}</dd>
          <dt>refused: too old</dt>
          <dd class={is?.reports?.refused ? "bad" : ""}>{count(is?.reports?.refused ?? 0)}</dd>
          <dt>counter restarts</dt>
          <dd>{count(is?.reports?.resets ?? 0)}</dd>
          <dt>first, last</dt>
          <dd>{is?.reports ? `${dateTime(is.reports.first_ms)}, ${dateTime(is.reports.last_ms)}` : "–"}</dd>
        </dl>
      </Section>
      <Section id="node-revisions" title="Desired settings" wide>
        <Fault text={given.fault} />
        {given.value?.revisions.length === 0 && <p class="message quiet">This hub has given it no setting.</p>}
        <ul class="events">
          {(given.value?.revisions ?? []).map((revision) => (
            <li key={revision.revision}>
              <time class="quiet">{dateTime(revision.at_ms)}</time> <a href={href(["revisions", String(revision.revision)])}>revision {revision.revision}</a>{" "}
              <Setting value={revision.to} /> by {revision.who} ({revision.origin}){revision.why ? `: ${revision.why}` : ""} · <Outcomes counts={revision.counts} />
            </li>
          ))}
        </ul>
      </Section>
    </>
  );
}

/** Removes a node that is gone from the list. */
function Forget({ name }: { name: string }) {
  const [fault, setFault] = useState("");
  const forget = async () => {
    if (!confirm(`Forget ${name}? Its clips and history stay; its desired setting is removed.`)) return;
    try {
      await answer(`/api/v1/nodes/${encodeURIComponent(name)}`, { method: "DELETE" });
      location.hash = href(["fleet"]);
    } catch (error) {
      setFault(messageOf(error));
    }
  };
  return (
    <div class="row">
      <button type="button" class="danger" disabled={whyNot() !== undefined} onClick={forget}>Forget this node</button>
      <Fault text={fault} />
    </div>
  );
}

export function EnergyTable({ energy }: { energy: Energy | undefined }) {
  if (!energy) return <p class="message quiet">…</p>;
  if (energy.groups.length === 0) return <p class="message quiet">No clip yet.</p>;
  const hasWay = energy.groups.some((group) => typeof group.joules_per_km === "number");
  return (
    <div class="scroll" tabIndex={0} role="group" aria-label="Energy by policy and value">
      <table>
        <thead>
          <tr>
            <th scope="col" class="left">policy and value</th>
            <th scope="col" class="left">energy is</th>
            {["clips", "hours", "skipped", "calls avoided", "recall against the detector", "energy", "per hour", ...(hasWay ? ["km", "per km"] : []), "saved ≈"].map((head) => (
              <th key={head} scope="col">{head}</th>
            ))}
          </tr>
        </thead>
        <tbody>
          {energy.groups.map((group) => (
            <tr key={`${group.group} ${group.quality}`}>
              <td class="left">{group.group || "all"}</td>
              <td class="left"><Quality quality={group.quality} /></td>
              <td>{count(group.clips)}</td>
              <td>{(group.duration_s / 3600).toFixed(1)}</td>
              <td>{percent(group.skip_rate)}</td>
              <td>{count(group.avoided_calls)}</td>
              <td>{group.audit?.recall ? `${percent(group.audit.recall.rate)} (${(100 * group.audit.recall.low).toFixed(1)} to ${(100 * group.audit.recall.high).toFixed(1)})` : "–"}</td>
              <td>{joules(group.joules)}</td>
              <td>{joules(group.duration_s ? (group.joules / group.duration_s) * 3600 : undefined)}</td>
              {hasWay && <td>{group.distance_km?.toFixed(1) ?? "–"}</td>}
              {hasWay && <td title="of the whole node, where energy and distance are known in full">{joules(group.joules_per_km)}</td>}
              <td>
                <Saved group={group} />
              </td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}
