// A node's page.

import { join } from "node:path";
import { ROOT, accessible, answers, assert, file, fits, folder, freePort, open, quiet, start, stop, test, until } from "./harness.mjs";

const frameNumber = async (page) => Number((await page.textContent("#picture-note")).match(/frame (\d+)/)?.[1]);
const pixels = (page) =>
  page.evaluate(() => {
    const canvas = document.querySelector("#canvas");
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let hash = 0;
    for (let at = 0; at < data.length; at += 997) hash = (hash * 31 + data[at]) | 0;
    return hash;
  });

export async function nodeTests(browser) {
  const [port, hubPort] = [await freePort(), await freePort()];
  const address = `http://127.0.0.1:${port}`;
  const demo = () => start(["demo", "--port", String(port), "--hub-port", String(hubPort), "--rate", "5"]);
  let node = demo();
  await answers(`${address}/readyz`, node);
  const page = await open(browser, address);

  await test("a node's page shows the node, its provider, and boxes that move", async () => {
    await page.getByRole("status").getByText("ready", { exact: true }).waitFor();
    assert((await page.textContent("header")).includes("cpu"), "the provider is not in the head");
    await until("a picture with boxes", async () => /% \((detected|predicted|rescued)\)/.test(await page.getAttribute("#canvas", "aria-label")));
    const [first, before] = [await frameNumber(page), await pixels(page)];
    await until("later frames", async () => (await frameNumber(page)) > first + 3);
    await until("another picture", async () => (await pixels(page)) !== before);
    await until("the share of avoided calls", async () => /\d\s?%/.test(await page.textContent("#saving .big")));
    // Looking at the pixels is this test's doing.
    quiet(page, /willReadFrequently/);
  });

  await test("a page that is opened now shows what happened before, and why the detector ran", async () => {
    const frames = await until("some frames that the node remembers", async () => {
      const { frames } = await (await fetch(`${address}/api/v1/cameras/dashcam/history`)).json();
      return frames.seq.length > 10 && frames;
    });
    const late = await open(browser, address);
    const first = await until("the past in the ribbon", async () => {
      const said = (await late.textContent("#ribbon .section-head")).match(/([\d,]+) frames/);
      return said && Number(said[1].replaceAll(",", "")) >= frames.seq.length;
    });
    assert(first, "fewer frames than the node remembers");
    await late.locator("canvas.ribbon").focus();
    await until("a frame with its cause", async () => {
      await late.keyboard.press("ArrowLeft");
      const told = await late.getAttribute("canvas.ribbon", "aria-valuetext");
      return /too uncertain|not certain yet|the screen saw|had gone without/.test(told);
    });
    assert(/^(uncertain|new object|screen|periodic cap|object's cap|no objects)/.test(await late.textContent(".causes dt")), await late.textContent(".causes"));
    quiet(late);
    await late.context().close();
  });

  await test("the slider says what its value would have skipped, as an estimate", async () => {
    await until("an estimate", async () => /≈ \d+.%/.test(await page.textContent("#would-skip")));
    const share = async () => Number((await page.textContent("#would-skip b")).match(/\d+/)[0]);
    const slider = page.getByRole("slider", { name: /on a logarithmic scale/ });
    await slider.fill("0");
    const low = await share();
    await slider.fill("200");
    const high = await share();
    assert(high > low, `${low} % at the least value and ${high} % at the largest`);
    await page.getByRole("button", { name: /Leave at/ }).click();
    quiet(page);
  });

  await test("the hub's page of a node shows it live, with a picture, while it is open", async () => {
    const hub = await open(browser, `http://127.0.0.1:${hubPort}/#/nodes/demo`);
    await until("counters", async () => /frames of dashcam/.test(await hub.textContent("#live")));
    const count = async () => Number((await hub.locator("#live dd").first().textContent()).replaceAll(",", ""));
    const before = await count();
    await until("later counters", async () => (await count()) > before);
    await hub.getByAltText("Newest picture of camera dashcam").waitFor();
    await accessible(hub, "a live node");
    quiet(hub);
    await hub.context().close();
  });

  await test("a node's page calls nobody else", async () => {
    assert([...page.called].join() === `127.0.0.1:${port}`, [...page.called].join());
  });

  await test("a change of u by keyboard alone shows in threshold, states and ribbon", async () => {
    const before = (await (await fetch(`${address}/api/v1/frame-states`)).json()).states;
    await page.locator("#picture button").first().focus();
    for (let tabs = 0; tabs < 20; tabs += 1) {
      if (await page.evaluate(() => document.activeElement?.id === "u")) break;
      await page.keyboard.press("Tab");
    }
    assert(await page.evaluate(() => document.activeElement?.id === "u"), "the field is not reached by Tab");
    await page.keyboard.press("Control+a");
    await page.keyboard.type("0.02");
    await page.keyboard.press("Enter");
    await page.getByText("from the next frame on").waitFor();
    await until("the value in force", async () => (await page.textContent("#in-force")) === "0.02");
    const shown = await until("more predicted frames", async () => {
      const { states } = await (await fetch(`${address}/api/v1/frame-states`)).json();
      return states.P > before.P + 10 && states;
    });
    await until("the page's count of them", async () => {
      const text = (await page.locator(".bar", { hasText: "predicted" }).locator(".number").textContent()).split("·")[0];
      return Number(text.replaceAll(",", "")) >= shown.P;
    });
    await page.locator("canvas.ribbon").focus();
    await page.keyboard.press("ArrowLeft");
    const held = await page.getAttribute("canvas.ribbon", "aria-valuetext");
    assert(/frame \d+ · .* · \d+ box/.test(held), held);
    await page.getByRole("button", { name: "Go on" }).waitFor();
    await page.keyboard.press("Escape");
    await page.getByRole("group", { name: "Frames" }).getByRole("button", { name: "Pause" }).waitFor();
    quiet(page);
  });

  await test("one click switches the policy while frames flow, and another one back", async () => {
    const before = await until("a picture", async () => (await frameNumber(page)) || 0);
    await page.getByRole("button", { name: "Switch to expected-loss" }).click();
    await page.getByRole("heading", { name: "Threshold lambda" }).waitFor();
    await until("the head's word", async () => /expected-loss, lambda = 0\.3/.test(await page.textContent("header")));
    await until("frames that go on", async () => (await frameNumber(page)) > before + 3);
    await page.locator("#saving").getByText(/^under expected-loss, since /).waitFor();
    const { latest, policy } = await until("a frame under it", async () => {
      const latest = await (await fetch(`${address}/api/v1/cameras/dashcam/detections`)).json();
      const policy = await (await fetch(`${address}/api/v1/policy`)).json();
      return latest.threshold?.name === "lambda" && { latest, policy };
    });
    assert(latest.threshold.value === 0.3 && policy.name === "expected-loss", JSON.stringify(policy));
    const { clips } = await (await fetch(`${address}/api/v1/clips?limit=5`)).json();
    assert(clips.some((clip) => clip.ended_by === "policy" && clip.policy === "albireo"), JSON.stringify(clips[0]));
    await page.locator("#policy summary").click();
    await accessible(page, "with the policies");
    await page.getByLabel("Another one").selectOption("vanilla");
    await page.getByRole("button", { name: "Switch", exact: true }).click();
    await page.getByText("The policy vanilla has no threshold.").waitFor();
    await page.getByLabel("Another one").selectOption("albireo");
    await page.getByRole("button", { name: "Switch", exact: true }).click();
    await page.getByRole("heading", { name: "Threshold u" }).waitFor();
    await page.locator("#policy summary").click();
    quiet(page);
  });

  await test("a refused value is told with its reason", async () => {
    await page.fill("#u", "7");
    await page.getByRole("button", { name: "Set", exact: true }).click();
    await until("the reason", async () => (await page.textContent("#threshold-message")) === "7 is too large: u is a number from 1e-9 to 1.");
    assert((await page.getAttribute("#u", "aria-invalid")) === "true", "the field is not marked");
    await page.getByRole("button", { name: /Leave at/ }).click();
    quiet(page);
  });

  await test("the page has no finding of axe and fits a phone, light and dark", async () => {
    await accessible(page, "1280, light");
    quiet(page);
    const phone = await open(browser, address, { width: 390, height: 844, scheme: "dark" });
    await until("a picture", async () => (await frameNumber(phone)) > 0);
    await fits(phone);
    await accessible(phone, "390, dark");
    quiet(phone);
    await phone.context().close();
  });

  await test("a node that restarts is followed without a reload", async () => {
    await stop(node, "SIGKILL");
    await page.getByText("node does not answer").waitFor();
    node = demo();
    await answers(`${address}/readyz`, node);
    await page.getByRole("status").getByText("ready", { exact: true }).waitFor();
    const first = await until("a frame of the new run", async () => (await frameNumber(page)) || 0);
    await until("later frames", async () => (await frameNumber(page)) > first + 2);
    quiet(page, /net::ERR/);
  });
  await page.context().close();
  await stop(node);

  await cameraTests(browser);
}

async function cameraTests(browser) {
  const [port, zenoh] = [await freePort(), await freePort()];
  const address = `http://127.0.0.1:${port}`;
  const env = {
    ALBIREO_HTTP__LISTEN: `127.0.0.1:${port}`,
    ALBIREO_ZENOH__LISTEN: `["tcp/127.0.0.1:${zenoh}"]`,
    ALBIREO_HTTP__TOKEN: "a-token-for-the-tests",
    ALBIREO_NODE__STATE_DIR: join(folder, "state"),
  };
  let node = start(["node"], env);
  await answers(`${address}/readyz`, node);
  const page = await open(browser, address);

  await test("a node with a token asks for it, without an error in the console", async () => {
    await page.getByLabel(/The token/).fill("not-the-token-of-this");
    await page.keyboard.press("Enter");
    await page.getByText("This token is not the node's").waitFor();
    await page.getByLabel(/The token/).fill("a-token-for-the-tests");
    await page.keyboard.press("Enter");
    await page.getByRole("heading", { name: "Threshold u" }).waitFor();
    quiet(page);
  });

  await test("a camera that was never seen shows the key to publish on", async () => {
    const tile = page.locator("#picture");
    await tile.getByText("never seen").waitFor();
    assert((await tile.textContent()).includes("albireo/node/front/frame"), await tile.textContent());
    await accessible(page, "never seen");
    quiet(page);
  });

  await test("the log's last lines and the archive for a diagnosis can be had", async () => {
    await page.getByRole("button", { name: "Show the last lines" }).click();
    await page.locator("#log").getByText("ready").first().waitFor();
    const saved = page.waitForEvent("download");
    await page.getByRole("button", { name: "Download all for a diagnosis" }).click();
    assert(/^albireo-node-.+\.tar$/.test((await saved).suggestedFilename()), (await saved).suggestedFilename());
    await accessible(page, "with the log");
    await page.getByRole("button", { name: "Hide" }).click();
    quiet(page);
  });

  await test("many faults are one line that opens, and every camera has a tile", async () => {
    const cameras = ["gate", "gone"].map((name) => `[[camera]]\nname = "${name}"\nsource = "rtsp://127.0.0.1:1/${name}"\n`);
    const others = ["a", "b", "c", "d", "e"].map((name) => `[[camera]]\nname = "${name}"\n`);
    const [port, zenoh] = [await freePort(), await freePort()];
    const config = file("seven.toml", `[http]\nlisten = "127.0.0.1:${port}"\n[zenoh]\nlisten = ["tcp/127.0.0.1:${zenoh}"]\n${[...cameras, ...others].join("")}`);
    const seven = start(["node", "--config", config]);
    await answers(`http://127.0.0.1:${port}/healthz`, seven);
    const phone = await open(browser, `http://127.0.0.1:${port}`, { width: 390, height: 844, scheme: "dark" });
    const faults = phone.locator(".faults");
    await faults.locator("summary").getByText(/faults?: .*gate/).waitFor();
    assert((await faults.locator("summary").boundingBox()).height < 60, "the faults are a wall");
    await faults.locator("summary").click();
    await faults.getByText(/127\.0\.0\.1:1/).first().waitFor();
    assert((await phone.locator(".tile").count()) === 7, "not seven tiles");
    const below = await phone.evaluate(() => document.querySelector("#threshold").getBoundingClientRect().top < document.querySelector("#uncertainty").getBoundingClientRect().top);
    assert(below, "the threshold comes after the charts");
    await fits(phone);
    await accessible(phone, "seven cameras, 390, dark");
    quiet(phone);
    await phone.context().close();
    await stop(seven);
  });

  await test("a dead camera is first, says why in a few words, and never shows another's picture", async () => {
    const [port, zenoh] = [await freePort(), await freePort()];
    const cameras = `[[camera]]\nname = "gate"\n[[camera]]\nname = "down"\nsource = "rtsp://127.0.0.1:1/stream"\n`;
    const config = file("two.toml", `[http]\nlisten = "127.0.0.1:${port}"\n[zenoh]\nlisten = ["tcp/127.0.0.1:${zenoh}"]\n${cameras}`);
    const two = start(["node", "--config", config]);
    await answers(`http://127.0.0.1:${port}/healthz`, two);
    const gate = start(["replay", "demo", "--loop", "--rate", "10", "--connect", `tcp/127.0.0.1:${zenoh}`, "--key", "albireo/node/gate/frame"]);
    const page = await open(browser, `http://127.0.0.1:${port}`);
    await until("the picture of gate", async () => (await frameNumber(page)) > 5);
    const first = page.locator(".tile").first();
    await first.getByText(/^refused by 127\.0\.0\.1:1, next try within [\d.]+ s$/).waitFor();
    assert((await first.locator(".tile-name").textContent()) === "down", "the failed camera is not the first");
    const top = (id) => page.evaluate((id) => document.querySelector(id).getBoundingClientRect().top, id);
    assert((await top("#cameras")) < (await top("#picture")), "the strip is below the picture");
    // Again and again: each time an answer of the live camera may still be on the way.
    for (let turn = 0; turn < 10; turn += 1) {
      await page.locator(".tile", { hasText: "gate" }).getByRole("button").click();
      await until("gate again", async () => (await page.getAttribute("#canvas", "aria-label")).startsWith("Picture of camera gate"));
      await first.getByRole("button").click();
      await page.locator(".no-picture").getByText(/^No picture of down yet: refused by/).waitFor();
      const seen = await page.evaluate(async () => {
        const canvas = document.querySelector("#canvas");
        const drawn = () => canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.some((value) => value !== 0);
        for (let frame = 0; frame < 30; frame += 1) {
          if (drawn()) return `a picture after ${frame} frames`;
          if (document.querySelector("#picture-note").textContent !== "") return document.querySelector("#picture-note").textContent;
          await new Promise(requestAnimationFrame);
        }
        return canvas.getAttribute("aria-label");
      });
      assert(seen === "No picture of camera down yet", seen);
    }
    quiet(page, /willReadFrequently/);
    await page.context().close();
    await stop(gate, "SIGKILL");
    await stop(two);
  });

  await test("a camera that stops is stale within five seconds", async () => {
    const camera = start(["replay", "demo", "--loop", "--rate", "5", "--connect", `tcp/127.0.0.1:${zenoh}`]);
    const tile = page.locator("#picture");
    await tile.getByText("live", { exact: true }).waitFor();
    await until("a few frames", async () => (await frameNumber(page)) > 8);
    await stop(camera, "SIGKILL");
    const stopped = Date.now();
    await tile.getByText(/stale/).waitFor();
    const took = (Date.now() - stopped) / 1000;
    console.log(`        stale after ${took.toFixed(1)} s`);
    assert(took <= 5, `${took} s`);
    quiet(page);
  });
  await stop(node);
  await page.context().close();

  await test("a broken detector is red, and its frames are not among the skipped", async () => {
    // Computes for ever on any picture that is bright somewhere: each run is given up, and the session is rebuilt.
    const model = join(ROOT, "tests/fixtures/models/hanging.onnx");
    node = start(["node"], { ...env, ALBIREO_DETECTOR__MODEL: model, ALBIREO_DETECTOR__TIMEOUT_MS: "300" });
    await until("the node answers", async () => (await fetch(`${address}/healthz`)).ok);
    const camera = start(["replay", "demo", "--loop", "--rate", "5", "--connect", `tcp/127.0.0.1:${zenoh}`]);
    const broken = await open(browser, address);
    await broken.getByLabel(/The token/).fill("a-token-for-the-tests");
    await broken.keyboard.press("Enter");
    const state = broken.getByRole("status").first().locator(".pill.bad");
    await state.waitFor();
    await broken.locator(".faults summary").getByText(/detector/).waitFor();
    await until("frames answered without the detector, or none at all", async () => {
      const states = await (await fetch(`${address}/api/v1/frame-states`, { headers: { Authorization: "Bearer a-token-for-the-tests" } })).json();
      return states.frames === 0 ? states.uptime_s > 10 : states.degraded_frames > 3 && states.skip_rate < 0.5;
    });
    const headline = await broken.textContent("#saving .big");
    assert(!headline.startsWith("100"), headline);
    quiet(broken);
    await stop(camera, "SIGKILL");
    await broken.context().close();
  });
  await stop(node, "SIGKILL");
}
