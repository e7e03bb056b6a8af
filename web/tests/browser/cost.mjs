// What it costs a node to be watched: its processor time and the latency of its frames with 0, 1 and 10 pages open.
// A page is played by what it calls: two event streams, a picture for every frame, the looks once a second,
// the past once, and what other values would have skipped every five seconds. (Browsers
// would take the processor that is being measured.) `node tests/browser/cost.mjs [SECONDS]`

import { readFileSync } from "node:fs";
import { answers, freePort, start, stop, stopAll } from "./harness.mjs";

const SECONDS = Number(process.argv[2] ?? 40);
const TICKS = 100;

const port = await freePort();
const address = `http://127.0.0.1:${port}`;
const node = start(["demo", "--port", String(port), "--rate", "10"]);
await answers(`${address}/readyz`, node);

function processorSeconds() {
  const fields = readFileSync(`/proc/${node.pid}/stat`, "utf8").split(") ")[1].split(" ");
  return (Number(fields[11]) + Number(fields[12])) / TICKS;
}

async function read(path, signal, onText) {
  const response = await fetch(address + path, { signal });
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    onText(value);
  }
}

/** Calls what a page calls until aborted; counts bytes. */
function page(signal) {
  const got = { bytes: 0 };
  const quiet = () => {};
  let asking = false;
  const load = async (path) => {
    got.bytes += (await (await fetch(address + path, { signal })).arrayBuffer()).byteLength;
  };
  const picture = async () => {
    if (asking) return;
    asking = true;
    await load("/api/v1/cameras/dashcam/frame.jpg").catch(quiet);
    asking = false;
  };
  read("/api/v1/events?types=counters,clip,threshold,detector", signal, (text) => (got.bytes += text.length)).catch(quiet);
  read("/api/v1/events?camera=dashcam&types=frame", signal, (text) => {
    got.bytes += text.length;
    void picture();
  }).catch(quiet);
  void Promise.all([load("/api/v1/cameras/dashcam/history?frames=4000"), load("/api/v1/power")]).catch(quiet);
  const estimates = setInterval(() => void load("/api/v1/cameras/dashcam/skip-estimate").catch(quiet), 5000);
  const timer = setInterval(() => void Promise.all([load("/api/v1/cameras"), load("/api/v1/node")]).catch(quiet), 1000);
  signal.addEventListener("abort", () => [timer, estimates].forEach(clearInterval));
  return got;
}

/** Latency of all frames in the meantime, milliseconds, by one stream that is always there. */
let latencies = [];
const always = new AbortController();
let rest = "";
read("/api/v1/events?types=frame", always.signal, (text) => {
  const blocks = (rest + text).split("\n\n");
  rest = blocks.pop();
  for (const block of blocks) {
    const data = block.split("data: ")[1];
    if (data) latencies.push(JSON.parse(data).latency_ms.total);
  }
}).catch(() => {});

const percentile = (share) => latencies.sort((a, b) => a - b)[Math.max(0, Math.ceil(share * latencies.length) - 1)];
console.log("| pages | processor, % of a core | frames | latency p50, ms | p99, ms | sent, kB/s |");
console.log("| --- | --- | --- | --- | --- | --- |");
for (const pages of [0, 1, 10, 0]) {
  const open = new AbortController();
  const watched = Array.from({ length: pages }, () => page(open.signal));
  await new Promise((done) => setTimeout(done, 3000));
  latencies = [];
  const [began, before] = [performance.now(), processorSeconds()];
  const bytesBefore = watched.reduce((sum, one) => sum + one.bytes, 0);
  await new Promise((done) => setTimeout(done, SECONDS * 1000));
  const seconds = (performance.now() - began) / 1000;
  const share = (100 * (processorSeconds() - before)) / seconds;
  const bytes = watched.reduce((sum, one) => sum + one.bytes, 0) - bytesBefore;
  console.log(`| ${pages} | ${share.toFixed(0)} | ${latencies.length} | ${percentile(0.5).toFixed(1)} | ${percentile(0.99).toFixed(1)} | ${(bytes / seconds / 1000).toFixed(0)} |`);
  open.abort();
}
always.abort();
await stop(node);
await stopAll();
