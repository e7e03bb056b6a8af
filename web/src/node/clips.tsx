// Clips with their energy, as a sortable table and as a CSV file.

import { useState } from "preact/hooks";
import { count, dateTime, duration, edp, joules, milliseconds, percent, small } from "../shared/format";
import { Quality, Section } from "../shared/parts";
import { arrow, csv, type Column, type Order, sorted } from "../shared/table";
import { cameras, clips, overview } from "./store";
import type { ClipReport } from "./types";

const SHOWN = 50;
/** Columns that clips of many nodes have no values for. */
const OPTIONAL = ["celsius", "throttled", "power_mode", "audit_recall", "audit_precision", "audit_boxes"];

/** The share of one side's boxes on a clip's audited frames that have a pair on the other side. */
export function paired(clip: ClipReport, side: "detected" | "shown"): number | undefined {
  const sums = clip.audit?.sums;
  const all = sums?.[side] ?? 0;
  return all > 0 ? (sums?.paired ?? 0) / all : undefined;
}

/** `yes`, `no`, or a dash where nothing is known. */
function throttled(clip: ClipReport) {
  if (clip.board?.throttled) return <b class="bad">yes</b>;
  return clip.board?.throttled === false ? "no" : "–";
}

function columns(several: boolean): Column<ClipReport>[] {
  return [
    { id: "started", head: "began", key: (clip) => clip.started_ns, cell: (clip) => dateTime(clip.started_ns / 1e6), unit: "ns since 1970" },
    { id: "clip", head: "clip", key: (clip) => clip.clip, cell: (clip) => clip.clip, left: true },
    ...(several ? [{ id: "camera", head: "camera", key: (clip: ClipReport) => clip.camera, cell: (clip: ClipReport) => clip.camera, left: true }] : []),
    // Each clip has its own: the policy may have been switched since.
    { id: "policy", head: "policy", key: (clip) => clip.policy, cell: (clip) => clip.policy, left: true },
    {
      id: "threshold", head: "threshold", key: (clip) => clip.threshold?.value,
      cell: (clip) => (clip.threshold ? `${clip.threshold.name} ${small(clip.threshold.value)}` : "–"),
    },
    { id: "frames", head: "frames", key: (clip) => clip.frames, cell: (clip) => count(clip.frames) },
    { id: "skip_rate", head: "skipped", key: (clip) => clip.skip_rate, cell: (clip) => percent(clip.skip_rate) },
    { id: "degraded_frames", head: "degraded", key: (clip) => clip.degraded_frames, cell: (clip) => count(clip.degraded_frames) },
    {
      id: "audit_recall", head: "recall*", key: (clip) => paired(clip, "detected"),
      cell: (clip) => percent(paired(clip, "detected")),
    },
    {
      id: "audit_precision", head: "precision*", key: (clip) => paired(clip, "shown"),
      cell: (clip) => percent(paired(clip, "shown")),
    },
    { id: "audit_boxes", head: "boxes*", key: (clip) => clip.audit?.sums?.detected, cell: (clip) => count(clip.audit?.sums?.detected) },
    { id: "duration", head: "length", key: (clip) => clip.duration_s, cell: (clip) => duration(clip.duration_s), unit: "s" },
    {
      id: "energy", head: "energy", key: (clip) => clip.energy.joules ?? undefined, unit: "J",
      // Joules that cover only part of the clip are marked.
      cell: (clip) => joules(clip.energy.joules) + (clip.energy.coverage < 0.999 ? ` for ${percent(clip.energy.coverage)} of the time` : ""),
    },
    { id: "edp", head: "EDP", key: (clip) => clip.energy.edp ?? undefined, cell: (clip) => edp(clip.energy.edp), unit: "J·ms/frame" },
    { id: "energy_is", head: "energy is", key: (clip) => clip.energy.quality, cell: (clip) => <Quality quality={clip.energy.quality} />, left: true },
    { id: "energy_source", head: "source", key: (clip) => clip.energy.source, cell: (clip) => clip.energy.source, left: true },
    { id: "latency_p50", head: "latency p50", key: (clip) => clip.total_latency_ms.p50, cell: (clip) => milliseconds(clip.total_latency_ms.p50), unit: "ms" },
    { id: "latency_p99", head: "p99", key: (clip) => clip.total_latency_ms.p99, cell: (clip) => milliseconds(clip.total_latency_ms.p99), unit: "ms" },
    { id: "detector_p50", head: "detector p50", key: (clip) => clip.detector_latency_ms.p50, cell: (clip) => milliseconds(clip.detector_latency_ms.p50), unit: "ms" },
    { id: "detector_p99", head: "p99", key: (clip) => clip.detector_latency_ms.p99, cell: (clip) => milliseconds(clip.detector_latency_ms.p99), unit: "ms" },
    { id: "provider", head: "provider", key: (clip) => clip.provider, cell: (clip) => clip.provider, left: true },
    { id: "celsius", head: "hottest", key: (clip) => clip.board?.hottest_celsius ?? undefined, cell: (clip) => (clip.board?.hottest_celsius ? `${clip.board.hottest_celsius.toFixed(0)} °C` : "–"), unit: "°C" },
    {
      id: "throttled", head: "throttled", key: (clip) => (clip.board?.throttled === undefined ? undefined : String(clip.board.throttled)),
      cell: throttled,
    },
    { id: "power_mode", head: "power mode", key: (clip) => clip.board?.power_mode ?? undefined, cell: (clip) => clip.board?.power_mode ?? "–", left: true },
  ];
}

export function Clips() {
  const [sorting, setSorting] = useState<{ id: string; order: Order }>({ id: "started", order: "descending" });
  const all = columns(cameras.value.length > 1);
  // A column is hidden if no clip has a value for it.
  const hasValue = (column: Column<ClipReport>) => clips.value.some((clip) => column.key(clip) !== undefined);
  const shown = all.filter((column) => !OPTIONAL.includes(column.id) || hasValue(column));
  const rows = sorted(clips.value, all.find((column) => column.id === sorting.id) ?? all[0]!, sorting.order);
  const sortBy = (id: string) => {
    const turns = sorting.id === id && sorting.order === "descending";
    setSorting({ id, order: turns ? "ascending" : "descending" });
  };
  const download = () => {
    const file = new Blob([csv(rows, all)], { type: "text/csv" });
    const link = document.createElement("a");
    link.href = URL.createObjectURL(file);
    link.download = `clips-${overview.value?.node ?? "node"}.csv`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };
  return (
    <Section
      id="clips"
      title="Clips"
      wide
      aside={
        <button type="button" class="plain" onClick={download} disabled={rows.length === 0}>
          Download {count(rows.length)} as CSV
        </button>
      }
    >
      {rows.length === 0 ? (
        <p class="message quiet">No clip has ended yet.</p>
      ) : (
        <div class="scroll" tabIndex={0} role="group" aria-label="table of clips">
          <table>
            <thead>
              <tr>
                {shown.map((column) => (
                  <th key={column.id} scope="col" class={column.left ? "left" : ""} aria-sort={sorting.id === column.id ? sorting.order : undefined}>
                    <button
                      type="button"
                      class="sort"
                      onClick={() => sortBy(column.id)}
                    >
                      {column.head}
                      <span aria-hidden="true">{sorting.id === column.id ? arrow(sorting.order) : ""}</span>
                    </button>
                  </th>
                ))}
              </tr>
            </thead>
            <tbody>
              {rows.slice(0, SHOWN).map((clip) => (
                <tr key={clip.id}>
                  {shown.map((column) => (
                    <td key={column.id} class={column.left ? "left" : ""}>
                      {column.cell(clip)}
                    </td>
                  ))}
                </tr>
              ))}
            </tbody>
          </table>
        </div>
      )}
      {rows.some((clip) => clip.audit) && (
        <p class="message quiet">* Compared with the detector, on the audited skipped frames only; a single clip has few boxes.</p>
      )}
      {rows.length > SHOWN && <p class="message quiet">The table shows the first {SHOWN} of {count(rows.length)} clips; the file has all.</p>}
    </Section>
  );
}
