// A line chart over time (uPlot), in the page's colours, light and dark.

import { useEffect, useRef } from "preact/hooks";
import uPlot from "uplot";
import { zone } from "./format";
import "uplot/dist/uPlot.min.css";

export interface Line {
  label: string;
  /** Name of a custom property with the colour. */
  colour: string;
  dash?: number[];
  /** Steps, for values that apply until they change. */
  steps?: boolean;
  /** Points without a line, for occasional values. */
  points?: boolean;
}

export interface ChartProps {
  /** Seconds since the Unix epoch, then one column for each line. */
  data: uPlot.AlignedData;
  lines: Line[];
  /** A description of the chart, for screen readers. */
  label: string;
  log?: boolean;
  /** Formats the values of the vertical axis. */
  value: (value: number) => string;
  height?: number;
  range?: [number | null, number | null];
  /** Charts with the same name share a crosshair. */
  sync?: string;
  onCursor?: (index: number | null) => void;
}

function colour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function options(props: ChartProps, width: number, cursor: (index: number | null) => void): uPlot.Options {
  const axis: uPlot.Axis = {
    stroke: () => colour("--quiet"),
    grid: { stroke: () => colour("--line"), width: 1 },
    ticks: { show: false },
    font: "12px system-ui, sans-serif",
  };
  return {
    width,
    height: props.height ?? 160,
    legend: { show: false },
    cursor: {
      y: false,
      ...(props.sync ? { sync: { key: props.sync } } : {}),
      points: { size: 6 },
    },
    scales: {
      x: { time: true },
      y: props.log
        ? { distr: 3 }
        : { range: { min: bound(props.range?.[0], 0.05), max: bound(props.range?.[1], 0.1) } },
    },
    axes: [
      { ...axis, size: 28, space: 80, values: (_, splits, __, ___, step) => splits.map((split) => moment(split, step)) },
      { ...axis, size: 62, space: 28, values: (_, values) => values.map((value) => (value === null ? "" : props.value(value))) },
    ],
    series: [
      {},
      ...props.lines.map(
        (line): uPlot.Series => ({
          label: line.label,
          stroke: () => colour(line.colour),
          width: line.points ? 0 : 1.5,
          ...(line.dash ? { dash: line.dash } : {}),
          ...(line.steps ? { paths: uPlot.paths.stepped!({ align: 1 }) } : {}),
          points: { show: line.points ? true : isLonely, size: 5, fill: () => colour(line.colour) },
        }),
      ),
    ],
    hooks: { setCursor: [(chart) => cursor(chart.cursor.idx ?? null)] },
  };
}

/** Whether a line has too few values to be seen as one. */
function isLonely(chart: uPlot, series: number): boolean {
  return (chart.data[series] ?? []).filter((value) => value !== null && value !== undefined).length < 3;
}

/** A time on the axis, as exact as the step between two labels requires, in 24 hours. */
function moment(seconds: number, step: number): string {
  const at = new Date(seconds * 1000);
  if (step >= 86_400) return at.toLocaleDateString(undefined, { day: "numeric", month: "short" });
  const clock = at.toLocaleTimeString("en-GB");
  if (step >= 60) return clock.slice(0, 5);
  return step >= 1 ? clock : `${clock}.${Math.floor(at.getMilliseconds() / 100)}`;
}

function bound(fixed: number | null | undefined, pad: number): uPlot.Range.Limit {
  return fixed === null || fixed === undefined ? { pad, soft: 0, mode: 1 } : { pad: 0, hard: fixed, soft: fixed, mode: 1 };
}

/** The chart with a legend that shows the value under the crosshair, or the last one. */
export function Chart(props: ChartProps) {
  const place = useRef<HTMLDivElement>(null);
  const legend = useRef<HTMLParagraphElement>(null);
  const chart = useRef<uPlot | null>(null);
  const current = useRef(props);
  current.current = props;

  const tell = (index: number | null) => {
    const { data, value } = current.current;
    const at = index ?? data[0].length - 1;
    legend.current?.querySelectorAll("output").forEach((output, line) => {
      const found = data[line + 1]?.[at];
      output.textContent = found === null || found === undefined ? "–" : value(found);
    });
  };

  useEffect(() => {
    const element = place.current!;
    const cursor = (index: number | null) => {
      tell(index);
      current.current.onCursor?.(index);
    };
    const made = new uPlot(options(current.current, element.clientWidth, cursor), current.current.data, element);
    chart.current = made;
    const resized = new ResizeObserver(() => {
      if (element.clientWidth) made.setSize({ width: element.clientWidth, height: current.current.height ?? 160 });
    });
    resized.observe(element);
    const dark = matchMedia("(prefers-color-scheme: dark)");
    const redraw = () => made.redraw(false);
    dark.addEventListener("change", redraw);
    return () => {
      dark.removeEventListener("change", redraw);
      resized.disconnect();
      made.destroy();
      chart.current = null;
    };
  }, []);

  useEffect(() => {
    chart.current?.setData(props.data);
    if ((chart.current?.cursor.idx ?? null) === null) tell(null);
  }, [props.data]);

  return (
    <figure class="chart">
      <div ref={place} role="img" aria-label={props.label} />
      <p class="legend" ref={legend}>
        {props.lines.map((line) => (
          <span key={line.label}>
            <i class={`swatch ${line.colour.slice(2)} ${line.dash ? "dashed" : ""} ${line.points ? "dotted" : ""}`} />
            {line.label} <output>–</output>
          </span>
        ))}
        <span class="zone">times in {zone()}</span>
      </p>
    </figure>
  );
}
