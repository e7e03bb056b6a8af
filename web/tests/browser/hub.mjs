// The hub's page.

import { join } from "node:path";
import { accessible, answers, assert, file, fits, folder, freePort, open, quiet, start, stop, test, until } from "./harness.mjs";

const NODES = Number(process.env.ALBIREO_NODES ?? 2_000);

export async function hubTests(browser) {
  const [port, zenoh] = [await freePort(), await freePort()];
  const address = `http://127.0.0.1:${port}`;
  const config = file("hub.toml", `
[zenoh]
listen = ["tcp/127.0.0.1:${zenoh}"]
[http]
listen = "127.0.0.1:${port}"
token = "a-token-that-may-tune"
[database]
url = "sqlite:${join(folder, "hub.db")}"
[[token]]
name = "looker"
role = "read"
token = "a-token-that-may-look"
`);
  let hub = start(["hub", "--config", config]);
  await answers(`${address}/readyz`, hub);

  await test("an empty hub says how a node gets there", async () => {
    const empty = await open(browser, address);
    await empty.getByLabel(/The token/).fill("a-token-that-may-look");
    await empty.keyboard.press("Enter");
    await empty.getByText("No node has reported to this hub yet").waitFor();
    assert((await empty.textContent("#fleet")).includes(`connect = ["tcp/127.0.0.1:7448"]`), await empty.textContent("#fleet"));
    await accessible(empty, "an empty hub");
    quiet(empty);
    await empty.context().close();
  });

  const fleet = start(["simulate", "--nodes", String(NODES), "--sessions", "20", "--connect", `tcp/127.0.0.1:${zenoh}`, "--seconds", "3000",
    "--clip-seconds", "40", "--gather", "1", "--status-seconds", "5", "--seed", "7"]);
  const headers = { Authorization: "Bearer a-token-that-may-tune" };
  await until("all nodes online", async () => {
    if (fleet.exitCode !== null) throw new Error(fleet.said);
    return (await (await fetch(`${address}/api/v1/nodes?limit=0`, { headers })).json()).counts.online === NODES;
  });
  const page = await open(browser, address);
  const unlock = async (page, token) => {
    await page.getByLabel(/The token/).fill(token);
    await page.keyboard.press("Enter");
  };
  const firstName = () => page.locator(".fleet-body .c-name a").first().textContent();
  const total = async () => Number((await page.locator("#fleet .section-head [role=status]").textContent()).replaceAll(",", "").match(/\d+/)?.[0]);

  /** Waits until the table shows what the hub says of the selection. */
  const shows = (query) =>
    until(`the rows of ${query || "all"}`, async () => {
      const hubs = await (await fetch(`${address}/api/v1/nodes?limit=1&${query}`, { headers })).json();
      if ((await total()) !== hubs.total) return false;
      // Rows of one energy or state change places by themselves; by name they do not.
      return /sort=/.test(query) || hubs.total === 0 || (await firstName()) === hubs.nodes[0].node;
    });

  await test("a fleet is shown in a line and as a table, without an error in the console", async () => {
    await unlock(page, "a-token-that-may-tune");
    await until("the whole fleet", async () => (await total()) === NODES);
    await page.locator(".fleet-body").getByText("sim-000003").waitFor();
    assert((await page.textContent(".by-state")).includes("online"), "no state in the summary");
    quiet(page);
  });

  await test("thousands of rows are scrolled with as many elements as fit on the screen", async () => {
    const scrolled = await page.evaluate(async () => {
      const body = document.querySelector(".fleet-body");
      const end = performance.now() + 3000;
      let frames = 0;
      let most = 0;
      while (performance.now() < end) {
        body.scrollTop += 150;
        await new Promise(requestAnimationFrame);
        frames += 1;
        most = Math.max(most, document.querySelectorAll(".fleet-body [role=row]").length);
      }
      body.scrollTop = body.scrollHeight;
      return { perSecond: frames / 3, most };
    });
    console.log(`        ${scrolled.perSecond.toFixed(0)} frames a second while scrolling, ${scrolled.most} rows in the page`);
    assert(scrolled.most < 60, `${scrolled.most} rows`);
    const last = `sim-${String(NODES - 1).padStart(6, "0")}`;
    await page.locator(".fleet-body").getByText(last).waitFor();
    quiet(page);
  });

  await test("what is sought, sorted and filtered is in the address, and there after a reload", async () => {
    await page.getByLabel("part of the name").fill("00042");
    await until("the found", async () => (await total()) < NODES && (await firstName()).includes("00042"));
    await page.getByRole("button", { name: "online", exact: true }).click();
    await until("the filter in the address", async () => /state=online/.test(page.url()));
    const head = page.locator(".fleet-head");
    await head.getByRole("button", { name: /^node/ }).click();
    await head.getByRole("button", { name: /^node/ }).click();
    await until("the other order", async () => page.url().includes("down=true"));
    const address_ = page.url();
    assert(/search=00042/.test(address_), address_);
    // On a busy machine nodes fall silent and come back: what the page shows is compared with what the hub says now.
    await shows("search=00042&state=online&down=true");
    await page.reload();
    await shows("search=00042&state=online&down=true");
    assert(page.url() === address_, page.url());
    await page.goto(`${address}/#/fleet?select=region%3Dnorth`);
    await shows("select=region%3Dnorth&sort=state&down=true");
    assert((await total()) > 0 && (await total()) < NODES, "a label's nodes");
    await page.goto(`${address}/#/fleet`);
    await shows("sort=state&down=true");
    await head.getByRole("button", { name: /^energy today/ }).click();
    await head.getByRole("button", { name: /^energy today/ }).click();
    await until("the order by energy", async () => /sort=joules/.test(page.url()) && /down=true/.test(page.url()));
    await shows("sort=joules&down=true");
    await until("figures of energy, the largest first", async () => {
      const cells = await page.locator(".fleet-body .c-joules").allTextContents();
      return cells.length > 10 && cells.slice(0, 3).every((cell) => /J/.test(cell));
    });
    quiet(page);
  });

  await test("a value is set for a selection, with the outcome at every node as it comes", async () => {
    await page.goto(`${address}/#/fleet`);
    await page.getByLabel(/for which nodes/).fill("sim-0000*");
    await page.getByLabel("value").fill("4.2e-4");
    await page.getByLabel(/why/).fill("a test of the page");
    await page.getByRole("button", { name: "Show who would change" }).click();
    await page.getByText("Nothing was changed:").waitFor();
    await until("who would change", async () => /100 would change/.test(await page.textContent(".given")));
    await page.getByRole("button", { name: /^Set u/ }).click();
    await until("all outcomes", async () => {
      const text = await page.textContent(".given");
      const [applied, refused] = [Number(text.match(/(\d+) in force/)?.[1] ?? 0), Number(text.match(/(\d+) refused/)?.[1] ?? 0)];
      return text.startsWith("Given: ") && applied + refused === 100 && applied > 90;
    });
    await page.getByRole("link", { name: /revision \d+/ }).click();
    await page.getByText("a test of the page").waitFor();
    quiet(page);
  });

  await test("a target replaces a value, shown at the node, and switched off", async () => {
    await page.goto(`${address}/#/nodes/sim-000005`);
    await page.getByLabel("threshold or target").selectOption("hold skip_rate");
    await page.getByLabel("value", { exact: true }).fill("0.6");
    await page.getByRole("button", { name: "Hold skip_rate = 0.6" }).click();
    await until("the outcome", async () => /1 in force/.test((await page.textContent(".given")) ?? ""));
    await until("the target at the node", async () => /skip rate 0\.6 of the frames.*the target is held; set by the hub/.test((await page.textContent("#held")) ?? ""));
    await page.locator("#node-revisions").getByText("hold skip_rate = 0.6").waitFor();
    await accessible(page, "a node with a target");
    await page.goto(`${address}/#/fleet?search=sim-000005`);
    await page.locator(".fleet-body .c-threshold").getByText("hold skip_rate = 0.6").waitFor();
    await page.goto(`${address}/#/nodes/sim-000005`);
    await page.getByLabel("threshold or target").selectOption("hold nothing");
    await page.getByRole("button", { name: "Hold nothing" }).click();
    await until("no target", async () => (await page.locator("#held").count()) === 0);
    quiet(page);
  });

  await test("one node's own page shows it with clips, reports and settings", async () => {
    await page.goto(`${address}/#/nodes/sim-000003`);
    await page.getByRole("heading", { name: "sim-000003" }).waitFor();
    await page.locator("#node-revisions").getByText("a test of the page").waitFor();
    await page.locator("#reports dd").first().waitFor();
    await until("a clip of it", async () => (await page.locator("#clips tbody tr").count()) > 0);
    await accessible(page, "a node of the fleet");
    quiet(page);
  });

  await test("a rollout is begun, watched by stages, and returned", async () => {
    await page.goto(`${address}/#/rollouts`);
    await page.getByLabel(/for which nodes/).fill("sim-00010*");
    await page.getByLabel("u", { exact: true }).fill("3.5e-4");
    await page.getByLabel(/stages/).fill("2, 100%");
    await page.getByRole("button", { name: /^Start/ }).click();
    await page.getByRole("heading", { name: /Rollout \d+/ }).waitFor();
    await until("the first stage's nodes", async () => /2 in force/.test(await page.textContent(".stages")));
    await accessible(page, "a rollout");
    await page.getByRole("button", { name: "Return the old values" }).click();
    await page.getByText("returned to the old values").waitFor();
    await page.locator(".stages").getByText("old value again").waitFor();
    await page.goto(`${address}/#/rollouts`);
    const card = page.locator(".card").first();
    await card.getByText("returned to the old values").waitFor();
    assert(!/in force/.test(await card.textContent()), "a returned value is said to be in force");
    quiet(page);
  });

  await test("every view has no finding of axe and fits a phone", async () => {
    const phone = await open(browser, address, { width: 390, height: 844, scheme: "dark" });
    await unlock(phone, "a-token-that-may-tune");
    for (const view of ["fleet", "energy", "rollouts", "trials", "revisions", "set-aside"]) {
      await phone.goto(`${address}/#/${view}`);
      await phone.locator("main section h2").first().waitFor();
      await until("what is loaded", async () => (await phone.locator("text=…").count()) === 0 || view === "fleet");
      await fits(phone);
      await accessible(phone, `${view}, 390, dark`);
    }
    quiet(phone);
    await phone.context().close();
  });

  await test("who may look cannot tune, and sees why", async () => {
    const looker = await open(browser, address);
    await unlock(looker, "a-token-that-may-look");
    await looker.getByText(/, read-only/).waitFor();
    assert(await looker.getByRole("button", { name: /^Set/ }).last().isDisabled(), "the button can be pressed");
    await looker.getByText(/needs a token with the role/).first().waitFor();
    quiet(looker);
    await looker.context().close();
  });

  await test("a hub that restarts is followed without a reload", async () => {
    await page.goto(`${address}/#/fleet`);
    await page.getByText("connected").waitFor();
    await stop(hub, "SIGKILL");
    await page.getByText("hub does not answer").waitFor();
    hub = start(["hub", "--config", config]);
    await answers(`${address}/readyz`, hub);
    await page.getByText("connected").waitFor();
    await until("the fleet", async () => (await total()) === NODES);
    quiet(page, /net::ERR|status of 503/);
  });

  await test("what needs attention is on top, with its whole name and reason, at 1280 and 390", async () => {
    const name = "vehicle-berlin-depot-0042-front-left-camera";
    const node = file("broken.toml", `
[node]
name = "${name}"
[http]
listen = "127.0.0.1:${await freePort()}"
[zenoh]
listen = ["tcp/127.0.0.1:${await freePort()}"]
[uplink]
connect = ["tcp/127.0.0.1:${zenoh}"]
[[camera]]
name = "rear"
source = "rtsp://127.0.0.1:1/stream"
`);
    const broken = start(["node", "--config", node]);
    for (const width of [1280, 390]) {
      const seen = await open(browser, `${address}/#/fleet`, { width, height: 900 });
      await unlock(seen, "a-token-that-may-look");
      const line = seen.locator(".attention li", { hasText: name });
      await line.getByText(/Connection refused/).waitFor();
      const cut = await line.evaluate((element) => element.scrollWidth > element.clientWidth || getComputedStyle(element).textOverflow === "ellipsis");
      assert(!cut, `the reason is cut at ${width}`);
      const row = seen.locator(".fleet-body .c-name a", { hasText: name });
      await row.waitFor();
      const hidden = await row.evaluate((link) => link.scrollHeight > link.clientHeight || link.scrollWidth > link.clientWidth);
      assert(!hidden, `the name is cut at ${width}`);
      await fits(seen);
      quiet(seen);
      await seen.context().close();
    }
    await stop(broken, "SIGKILL");
  });

  await page.context().close();
  await stop(fleet, "SIGKILL");
  await stop(hub);
}
