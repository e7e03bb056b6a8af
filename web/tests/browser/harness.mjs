// What the browser tests share: the program's processes, a browser, and checks that wait for what is promised.

import { spawn } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { chromium } from "playwright-core";

export const ROOT = new URL("../../..", import.meta.url).pathname;
export const PROGRAM = process.env.ALBIREO_BIN ?? join(ROOT, "target/debug/albireo");
/** The longest that anything may take on a busy machine. */
export const PATIENCE = 120_000;

export const folder = mkdtempSync(join(tmpdir(), "albireo-pages-"));
const running = new Set();

export function freePort() {
  return new Promise((done, failed) => {
    const server = createServer();
    server.on("error", failed);
    server.listen(0, "127.0.0.1", () => {
      const { port } = server.address();
      server.close(() => done(port));
    });
  });
}

/** Starts the program; what it says is shown when a test fails. */
export function start(args, env = {}) {
  const child = spawn(PROGRAM, args, { cwd: ROOT, env: { ...process.env, ...env }, stdio: ["ignore", "pipe", "pipe"] });
  child.said = "";
  for (const stream of [child.stdout, child.stderr]) {
    stream.on("data", (data) => (child.said = (child.said + data).slice(-4000)));
  }
  child.ended = new Promise((done) => child.on("exit", done));
  running.add(child);
  child.ended.then(() => running.delete(child));
  return child;
}

export async function stop(child, signal = "SIGTERM") {
  child.kill(signal);
  await child.ended;
}

export async function stopAll() {
  await Promise.all([...running].map((child) => stop(child, "SIGKILL")));
  rmSync(folder, { recursive: true, force: true });
}

/** Waits until `look` gives something true. */
export async function until(what, look, patience = PATIENCE) {
  const end = Date.now() + patience;
  let last;
  while (Date.now() < end) {
    try {
      const found = await look();
      if (found) return found;
    } catch (error) {
      last = error;
    }
    await new Promise((done) => setTimeout(done, 100));
  }
  throw new Error(`not within ${patience / 1000} s: ${what}${last ? ` (${last.message})` : ""}`);
}

export async function answers(address, child) {
  await until(`${address} answers`, async () => {
    if (child.exitCode !== null) return "ended";
    return (await fetch(address)).status === 200;
  });
  assert(child.exitCode === null, `it has ended: ${child.said}`);
}

export function file(name, text) {
  const path = join(folder, name);
  writeFileSync(path, text);
  return path;
}

const CHROMIUM = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"].find(existsSync);

export function launch() {
  return chromium.launch({
    executablePath: process.env.ALBIREO_CHROMIUM ?? CHROMIUM,
    args: ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
      "--disable-component-update", "--disable-sync"],
  });
}

/** A page that remembers what its console complained about, and whom it called. */
export async function open(browser, address, { width = 1280, height = 900, scheme = "light" } = {}) {
  const context = await browser.newContext({ viewport: { width, height }, colorScheme: scheme });
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE);
  page.complaints = [];
  page.called = new Set();
  page.on("console", (message) => {
    if (["error", "warning"].includes(message.type())) page.complaints.push(`${message.text()} ${message.location().url}`);
  });
  page.on("pageerror", (error) => page.complaints.push(error.message));
  page.on("request", (request) => {
    const url = new URL(request.url());
    if (url.protocol !== "blob:") page.called.add(url.host);
  });
  await page.goto(address);
  return page;
}

export function assert(holds, what) {
  if (!holds) throw new Error(what);
}

/** Fails when the console had something to say, but for what `allowed` matches. */
export function quiet(page, allowed = /$^/) {
  const loud = page.complaints.filter((text) => !allowed.test(text));
  page.complaints = [];
  assert(loud.length === 0, `the console says: ${loud.join("; ")}`);
}

const AXE = readFileSync(new URL("../../node_modules/axe-core/axe.min.js", import.meta.url), "utf8");

/** No finding of axe, the accessibility checker. */
export async function accessible(page, what) {
  await page.evaluate(AXE);
  const { violations } = await page.evaluate(() => window.axe.run(document, { resultTypes: ["violations"] }));
  const findings = violations.map((one) => `${one.id}: ${one.nodes.slice(0, 3).map((node) => `${node.target} ${node.failureSummary ?? ""}`).join(" | ")}`);
  assert(findings.length === 0, `${what}: ${findings.join("\n")}`);
}

export async function fits(page) {
  const [wide, window] = await page.evaluate(() => [document.documentElement.scrollWidth, innerWidth]);
  assert(wide <= window, `the page is ${wide} wide in a window of ${window}`);
}

let failures = 0;

export async function test(name, work) {
  const wanted = process.argv[2];
  if (wanted && !name.includes(wanted)) return;
  const began = Date.now();
  try {
    await work();
    console.log(`ok      ${name} (${((Date.now() - began) / 1000).toFixed(1)} s)`);
  } catch (error) {
    failures += 1;
    console.log(`FAILED  ${name}\n        ${error.stack ?? error}`);
  }
}

export function result() {
  return failures;
}
