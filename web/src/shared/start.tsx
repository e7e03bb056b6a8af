// Starts a page.

import type { Signal } from "@preact/signals";
import { render } from "preact";
import type { VNode } from "preact";
import { askWho, messageOf, pause } from "./api";

/** Shows `page`, then asks the service who the caller is until it answers: it may still be starting. `lost` has the reason. */
export async function start(page: VNode, lost: Signal<string | undefined>): Promise<void> {
  render(page, document.getElementById("page")!);
  for (;;) {
    try {
      await askWho();
      lost.value = undefined;
      return;
    } catch (error) {
      lost.value = messageOf(error);
      await pause(1000);
    }
  }
}
