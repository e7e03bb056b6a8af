// The hub's page with many nodes: frames a second while the table is scrolled, and the page's heap over time.
// `node tests/browser/scale.mjs [NODES] [MINUTES] [CLIP_S] [STATUS_S]`, by default 10,000 nodes, 10 minutes, 40 s and 30 s.

import { join } from "node:path";
import { answers, file, folder, freePort, launch, open, start, stop, stopAll, until } from "./harness.mjs";

const NODES = Number(process.argv[2] ?? 10_000);
const MINUTES = Number(process.argv[3] ?? 10);
/** Seconds of a clip and between two signs of life; longer ones where hub, simulator and browser share few cores. */
const [CLIP_S, STATUS_S] = [process.argv[4] ?? "40", process.argv[5] ?? "30"];

const [port, zenoh] = [await freePort(), await freePort()];
const address = `http://127.0.0.1:${port}`;
const config = file("scale.toml", `
[zenoh]
listen = ["tcp/127.0.0.1:${zenoh}"]
[http]
listen = "127.0.0.1:${port}"
[database]
url = "sqlite:${join(folder, "scale.db")}"
`);
const hub = start(["hub", "--config", config]);
await answers(`${address}/readyz`, hub);
const fleet = start(["simulate", "--nodes", String(NODES), "--sessions", "20", "--connect", `tcp/127.0.0.1:${zenoh}`,
  "--seconds", String(MINUTES * 60 + 900), "--clip-seconds", CLIP_S, "--status-seconds", STATUS_S, "--gather", "1", "--no-notices", "--seed", "7"]);
const read = async (path) => (await fetch(address + path)).json();
await until("all nodes known", async () => {
  if (fleet.exitCode !== null) throw new Error(fleet.said);
  return (await read("/api/v1/nodes?limit=0")).total >= NODES;
}, 900_000);
const browser = await launch();
const page = await open(browser, address);
await until("the rows", async () => (await page.locator(".fleet-body .c-name a").count()) > 5);
const devtools = await page.context().newCDPSession(page);
await devtools.send("HeapProfiler.enable");

/** What is reachable on the page's heap, MB: after a collection, or it would be a measure of when the last one was. */
async function heap() {
  await devtools.send("HeapProfiler.collectGarbage");
  const { usedSize } = await devtools.send("Runtime.getHeapUsage");
  return usedSize / 1e6;
}

/** Frames a second over five seconds, with `step` pixels scrolled in each; the same page at rest is the browser's own limit. */
function frames(step) {
  return page.evaluate(async (step) => {
    const body = document.querySelector(".fleet-body");
    const began = performance.now();
    const gaps = [];
    let last = began;
    let most = 0;
    while (last < began + 5000) {
      if (step) body.scrollTop = body.scrollTop + step >= body.scrollHeight - body.clientHeight ? 0 : body.scrollTop + step;
      const now = await new Promise(requestAnimationFrame);
      gaps.push(now - last);
      last = now;
      most = Math.max(most, document.querySelectorAll(".fleet-body [role=row]").length);
    }
    gaps.sort((a, b) => a - b);
    return { perSecond: (1000 * gaps.length) / (last - began), p95: gaps[Math.floor(gaps.length * 0.95)], most };
  }, step);
}

console.log("| scrolled, pixels a frame | frames a second | 95th percentile between two, ms | rows in the page |");
console.log("| --- | --- | --- | --- |");
for (const step of [0, 20, 150, 1500, 0]) {
  const { perSecond, p95, most } = await frames(step);
  console.log(`| ${step} | ${perSecond.toFixed(0)} | ${p95.toFixed(1)} | ${most} |`);
}
if (MINUTES > 0) {
  console.log("\n| minute | heap, MB | elements |");
  console.log("| --- | --- | --- |");
  for (let minute = 0; minute <= MINUTES; minute += 1) {
    const elements = await page.evaluate(() => document.querySelectorAll("*").length);
    console.log(`| ${minute} | ${(await heap()).toFixed(2)} | ${elements} |`);
    if (minute < MINUTES) await new Promise((done) => setTimeout(done, 60_000));
  }
}
await browser.close();
await stop(fleet, "SIGKILL");
await stop(hub);
await stopAll();
