// The page of a fleet.

import { useEffect } from "preact/hooks";
import { caller } from "../shared/api";
import { Unlock } from "../shared/parts";
import { start } from "../shared/start";
import "../shared/style.css";
import "./style.css";
import { Aside, OneRevision, Revisions } from "./revisions";
import { EnergyView } from "./energy";
import { Fleet } from "./fleet";
import { Node } from "./node";
import { Rollout, Rollouts } from "./rollouts";
import { route } from "./route";
import { lost, watchFleet } from "./store";
import { Header, Summary } from "./summary";
import { Trial, Trials } from "./trials";

function View() {
  const [view, name] = route.value.path;
  switch (view) {
    case "nodes": return name === undefined ? <Fleet /> : <Node key={name} name={name} />;
    case "energy": return <EnergyView />;
    case "rollouts": return name === undefined ? <Rollouts /> : <Rollout key={name} id={name} />;
    case "trials": return name === undefined ? <Trials /> : <Trial key={name} id={name} />;
    case "revisions": return name === undefined ? <Revisions /> : <OneRevision key={name} id={name} />;
    case "set-aside": return <Aside />;
    default: return <Fleet />;
  }
}

function Page() {
  const who = caller.value;
  const locked = who?.token_needed ?? false;
  const open = who !== undefined && !locked;
  useEffect(() => {
    if (!open) return;
    const stop = new AbortController();
    watchFleet(stop.signal);
    return () => stop.abort();
  }, [open]);
  const [view, name] = route.value.path;
  useEffect(() => {
    document.title = `${name ?? view} · albireo fleet`;
  }, [view, name]);
  if (locked) return <Unlock what="hub" />;
  return (
    <>
      <Header />
      {open && (
        <main class="hub">
          <Summary />
          <View />
        </main>
      )}
    </>
  );
}

void start(<Page />, lost);
