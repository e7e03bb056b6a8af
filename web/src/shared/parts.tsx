// Small parts that both pages use.

import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";
import { answer, caller, messageOf, tokenRefused, useToken } from "./api";

export type Mood = "good" | "bad" | "wait" | "none";

export function Pill({ mood, children, title }: { mood: Mood; children: ComponentChildren; title?: string }) {
  return (
    <span class={`pill ${mood}`} title={title}>
      {children}
    </span>
  );
}

/** A mark for the quality of an energy figure: filled if measured, an outline with ≈ if estimated. */
export function Quality({ quality }: { quality: string }) {
  const words: Record<string, string> = {
    measured: "measured",
    partial: "measured in part",
    estimated: "≈ estimated",
    unavailable: "no figure",
  };
  return <span class={`quality ${quality}`}>{words[quality] ?? quality}</span>;
}

export function Figure({ label, children, note }: { label: string; children: ComponentChildren; note?: ComponentChildren }) {
  return (
    <div class="figure">
      <dt>{label}</dt>
      <dd>{children}</dd>
      {note !== undefined && <dd class="note">{note}</dd>}
    </div>
  );
}

export function Section(props: {
  id: string;
  title: string;
  wide?: boolean;
  aside?: ComponentChildren;
  children: ComponentChildren;
}) {
  return (
    <section aria-labelledby={`${props.id}-title`} id={props.id} class={props.wide ? "wide" : undefined}>
      <div class="section-head">
        <h2 id={`${props.id}-title`}>{props.title}</h2>
        {props.aside}
      </div>
      {props.children}
    </section>
  );
}

/** Whether a label is the address of a page, and no script. */
export function isPage(address: string | null | undefined): address is string {
  return /^https?:\/\/[^\s]+$/.test(address ?? "");
}

/** Asks for the token; shown in place of everything that needs one. */
export function Unlock({ what }: { what: string }) {
  const [text, setText] = useState("");
  const [fault, setFault] = useState("");
  const submit = async (event: Event) => {
    event.preventDefault();
    setFault("");
    try {
      await useToken(text);
    } catch (error) {
      setFault(messageOf(error));
    }
    setText("");
  };
  return (
    <main class="narrow">
      <section aria-labelledby="unlock-title" class="wide">
        <h2 id="unlock-title">This {what} requires a token</h2>
        <form onSubmit={submit}>
          <label for="token">The token from the {what}'s configuration. It is kept until this tab is closed.</label>
          <div class="row">
            <input
              id="token"
              type="password"
              autocomplete="off"
              required
              autofocus
              value={text}
              onInput={(event) => setText(event.currentTarget.value)}
            />
            <button>Open</button>
          </div>
          <p class="message bad" role="alert">
            {fault || (tokenRefused.value ? `This token is not the ${what}'s.` : "")}
          </p>
        </form>
      </section>
    </main>
  );
}

/** The reason why the caller cannot change settings; undefined if it can. */
export function whyNot(): string | undefined {
  const who = caller.value;
  return who && !who.may_tune
    ? `The token “${who.name}” can read but not change settings. This needs a token with the role “tune”.`
    : undefined;
}

export function CopyButton({ text }: { text: string }) {
  const [done, setDone] = useState(false);
  const copy = async () => {
    // Available only on localhost and over TLS.
    await navigator.clipboard?.writeText(text);
    setDone(true);
    setTimeout(() => setDone(false), 1500);
  };
  if (!navigator.clipboard) return null;
  return (
    <button type="button" class="plain" onClick={copy}>
      {done ? "Copied" : "Copy"}
    </button>
  );
}

export function Fault({ text }: { text: string }) {
  return (
    <p class="message bad" role="alert">
      {text}
    </p>
  );
}

/** Downloads the answer of a path; a link could not carry the token. */
export function Download({ path, name, children }: { path: string; name: string; children: ComponentChildren }) {
  const [fault, setFault] = useState("");
  const load = async () => {
    setFault("");
    try {
      const file = await (await answer(path)).blob();
      const link = document.createElement("a");
      link.href = URL.createObjectURL(file);
      link.download = name;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    } catch (error) {
      setFault(messageOf(error));
    }
  };
  return (
    <>
      <button type="button" class="plain" onClick={load}>
        {children}
      </button>
      <Fault text={fault} />
    </>
  );
}
