// The pages in Debian's Chromium against the program itself. `node tests/browser/main.mjs WORDS` runs those whose name
// has WORDS in it.

import { hubTests } from "./hub.mjs";
import { nodeTests } from "./node.mjs";
import { launch, result, stopAll } from "./harness.mjs";

const browser = await launch();
try {
  await nodeTests(browser);
  await hubTests(browser);
} finally {
  await browser.close();
  await stopAll();
}
process.exitCode = result() ? 1 : 0;
