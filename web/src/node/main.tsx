// The page of one node.

import { useEffect } from "preact/hooks";
import { caller } from "../shared/api";
import { Unlock } from "../shared/parts";
import { start } from "../shared/start";
import "../shared/style.css";
import { Audit } from "./audit";
import { Tiles } from "./cameras";
import { DetectorTime, Power, Rates, Uncertainty } from "./charts";
import { Clips } from "./clips";
import { Header, Headline, Saving } from "./header";
import { Health } from "./health";
import { ThresholdPanel } from "./threshold";
import { Log } from "./log";
import { Picture } from "./picture";
import { PolicyPanel } from "./policy";
import { Ribbon } from "./ribbon";
import { ScreenPanel } from "./screen";
import { States } from "./states";
import { TargetPanel } from "./target";
import { cameras, lost, opened, overview, watchFrames, watchNode } from "./store";

function Page() {
  const who = caller.value;
  const locked = who?.token_needed ?? false;
  const open = who !== undefined && !locked;
  useEffect(() => {
    if (!open) return;
    const stop = new AbortController();
    watchNode(stop.signal);
    return () => stop.abort();
  }, [open]);
  const camera = opened.value;
  const known = cameras.value.some((entry) => entry.camera === camera);
  useEffect(() => {
    if (!open || camera === undefined || !known) return;
    const stop = new AbortController();
    watchFrames(camera, stop.signal);
    return () => stop.abort();
  }, [open, camera, known]);

  if (locked) return <Unlock what="node" />;
  return (
    <>
      <Header />
      {open && (
        <main>
          <Headline />
          {cameras.value.length > 1 && <Tiles />}
          <div class="stack">
            <Picture />
            <TargetPanel />
            <PolicyPanel />
          </div>
          <div class="stack">
            <Saving />
            <ThresholdPanel />
            <ScreenPanel />
          </div>
          <Ribbon />
          <div class="stack">
            <States />
            <Uncertainty />
            <Rates />
          </div>
          <div class="stack">
            <Health />
            <Power />
            <DetectorTime />
          </div>
          <Audit />
          <Clips />
          <Log name={overview.value?.node} />
        </main>
      )}
    </>
  );
}

void start(<Page />, lost);
