// SPDX-License-Identifier: MIT
// What is said in a room: pins with their threads, decisions, and both on paper.
import { computed, signal, useSignal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import type { Decision, Note, Pin, RoomState, Stamp } from "../gen/relight_pb";
import { sameJson } from "../room/convert";
import {
  act,
  isNew,
  mayReview,
  markRead,
  myName,
  pictureOf,
  pinScene,
  state,
} from "../room/session";
import type { Point } from "../room/pick";
import { Choice, Section } from "./controls";
import { fault } from "./store";

/** The next click on the model places a pin. */
export const pinMode = signal(false);
/** Where the pin goes whose text is being written. */
export const newPin = signal<Point | null>(null);
/** Sequence of the pin whose thread is open. */
export const openPin = signal<bigint | null>(null);
export const printing = signal(false);

type Filter = "open" | "resolved" | "mine" | "all";
const filter = signal<Filter>("open");

const numberOf = (item: { stamp?: Stamp }) => item.stamp?.sequence ?? 0n;
const byOf = (stamp: Stamp | undefined) => stamp?.name || stamp?.by || "";
const timeOf = (stamp: Stamp | undefined) =>
  new Date(Number((stamp?.timeUs ?? 0n) / 1000n)).toLocaleString([], {
    dateStyle: "medium",
    timeStyle: "short",
  });

function isMine(pin: Pin): boolean {
  const name = myName.value.toLowerCase();
  return (
    name !== "" &&
    pin.notes.some(
      (note) =>
        note.stamp?.name.toLowerCase() === name ||
        note.mentions.some((word) => name.startsWith(word.toLowerCase())),
    )
  );
}
export const shownPins = computed(() =>
  (state.value?.pins ?? []).filter((pin) => {
    if (filter.value === "all") return true;
    if (filter.value === "mine") return isMine(pin);
    return pin.resolved === (filter.value === "resolved");
  }),
);

export function jumpToPin(by: number): void {
  const all = shownPins.value;
  if (!all.length) return;
  const at = all.findIndex((pin) => numberOf(pin) === openPin.value);
  const next = all[(at + by + all.length) % all.length] ?? all[0];
  openPin.value = next ? numberOf(next) : null;
}

/** Number of the revision that the scene is now; 0: it is none. */
function revisionNow(now: RoomState): number {
  return (
    [...now.revisions].reverse().find((one) => sameJson(one.scene, now.scene))?.number ?? 0
  );
}

function Picture({ what, alt }: { what: { pin?: bigint; decision?: bigint }; alt: string }) {
  const address = useSignal("");
  useEffect(() => {
    pictureOf(what).then((url) => (address.value = url), fault);
  }, [what.pin, what.decision]);
  return address.value ? (
    <img class="seen" src={address.value} alt={alt} />
  ) : (
    <div class="seen" role="status" aria-label="The daemon draws the picture" />
  );
}

function Said({ note }: { note: Note }) {
  if (!note.text) return <li class="hint">erased</li>;
  return (
    <li>
      <small>
        <b>{byOf(note.stamp)}</b> {timeOf(note.stamp)}
        {note.changedUs > 0n && ", changed"}
      </small>
      <p>{note.text}</p>
    </li>
  );
}

function Thread({ pin }: { pin: Pin }) {
  const text = useSignal("");
  const number = numberOf(pin);
  const send = () => {
    if (!text.value.trim()) return;
    const said = text.value.trim();
    text.value = "";
    void act({ reply: { target: number, text: said } });
  };
  return (
    <div class="thread">
      <Picture what={{ pin: number }} alt={`What ${byOf(pin.stamp)} saw`} />
      <ul>
        {pin.notes.map((note) => (
          <Said key={String(numberOf(note))} note={note} />
        ))}
      </ul>
      {mayReview.value && (
        <form
          onSubmit={(event) => {
            event.preventDefault();
            send();
          }}
        >
          <textarea
            id="reply"
            aria-label="Reply"
            placeholder="Reply, @name mentions"
            value={text.value}
            onInput={(event) => (text.value = event.currentTarget.value)}
            onKeyDown={(event) => {
              if (event.key === "Enter" && (event.ctrlKey || event.metaKey)) send();
              if (event.key === "Escape") event.currentTarget.blur();
            }}
          />
          <div class="row">
            <button type="submit" class="primary" disabled={!text.value.trim()}>
              Reply
            </button>
            <button
              type="button"
              onClick={() => void act({ status: { pin: number, resolved: !pin.resolved } })}
            >
              {pin.resolved ? "Reopen" : "Resolve"}
            </button>
          </div>
        </form>
      )}
    </div>
  );
}

function PinRow({ pin }: { pin: Pin }) {
  const number = numberOf(pin);
  const open = openPin.value === number;
  return (
    <li class={`pin-row ${pin.resolved ? "resolved" : ""}`}>
      <button
        type="button"
        class="pin-title"
        aria-expanded={open}
        onClick={() => (openPin.value = open ? null : number)}
      >
        <span class="pin-number">{pinLabel(number)}</span>
        <span class="pin-text">{pin.notes[0]?.text || "erased"}</span>
        {pin.notes.length > 1 && <small>{pin.notes.length - 1}</small>}
        {isNew(pin) && <i class="unread" aria-label="unread" />}
      </button>
      {open && <Thread pin={pin} />}
    </li>
  );
}
/** Pins are counted in the order in which they were placed. */
export const pinLabel = (number: bigint) =>
  1 + (state.value?.pins ?? []).findIndex((pin) => numberOf(pin) === number);

function NewPin() {
  const text = useSignal("");
  const at = newPin.value;
  if (!at) return null;
  const place = () => {
    const [x, y, z] = at.position;
    newPin.value = null;
    void act({
      pin: { text: text.value.trim(), at: { ...at, position: { x, y, z } }, scene: pinScene() },
    }).then((answer) => {
      if (answer) openPin.value = answer.sequence;
    });
  };
  return (
    <form
      class="new-pin"
      onSubmit={(event) => {
        event.preventDefault();
        if (text.value.trim()) place();
      }}
    >
      <textarea
        aria-label="What is wrong here"
        placeholder="What is wrong here? @name mentions"
        autofocus
        ref={(node) => node?.focus()}
        value={text.value}
        onInput={(event) => (text.value = event.currentTarget.value)}
        onKeyDown={(event) => {
          if (event.key === "Escape") newPin.value = null;
          if (event.key === "Enter" && (event.ctrlKey || event.metaKey) && text.value.trim())
            place();
        }}
      />
      <div class="row">
        <button type="submit" class="primary" disabled={!text.value.trim()}>
          Place the pin
        </button>
        <button type="button" class="quiet" onClick={() => (newPin.value = null)}>
          Cancel
        </button>
      </div>
    </form>
  );
}

function verdict(decision: Decision, now: number): string {
  const at = decision.seen?.revision ?? 0;
  const word = decision.approve ? "approved" : "rejected";
  if (at === now) return `${word} as it is now`;
  return now
    ? `${word} at revision ${at}, now at ${now}`
    : `${word} at revision ${at}, changed since`;
}

function Decisions() {
  const note = useSignal("");
  const now = state.value;
  if (!now) return null;
  const revision = revisionNow(now);
  const decide = (approve: boolean) => {
    void act({ decide: { approve, note: note.value.trim(), scene: pinScene() } });
    note.value = "";
  };
  return (
    <Section title="Decisions">
      <ul class="decisions">
        {now.decisions.map((one) => (
          <li key={String(numberOf(one))} class={one.approve ? "approved" : "rejected"}>
            <b>{verdict(one, revision)}</b>
            <small>
              {byOf(one.stamp)}, {timeOf(one.stamp)}
            </small>
            {one.note && <p>{one.note}</p>}
          </li>
        ))}
        {!now.decisions.length && <li class="hint">Nothing is decided yet.</li>}
      </ul>
      {mayReview.value && (
        <form class="decide" onSubmit={(event) => event.preventDefault()}>
          <input
            aria-label="Note of the decision"
            placeholder="Note"
            value={note.value}
            onInput={(event) => (note.value = event.currentTarget.value)}
          />
          <div class="row">
            <button type="button" class="primary" onClick={() => decide(true)}>
              Approve
            </button>
            <button type="button" onClick={() => decide(false)}>
              Reject
            </button>
          </div>
        </form>
      )}
    </Section>
  );
}

export function ReviewPanel() {
  const pins = shownPins.value;
  return (
    <>
      <Section title="Pins">
        <Choice<Filter>
          label="Which pins"
          value={filter.value}
          options={[
            { value: "open", label: "Open" },
            { value: "resolved", label: "Resolved" },
            { value: "mine", label: "Mine" },
            { value: "all", label: "All" },
          ]}
          onChange={(value) => (filter.value = value)}
        />
        <NewPin />
        <ul class="pins">
          {pins.map((pin) => (
            <PinRow key={String(numberOf(pin))} pin={pin} />
          ))}
          {!pins.length && <li class="hint">No pin is here. P and a click place one.</li>}
        </ul>
        <button type="button" class="quiet" onClick={markRead}>
          Mark all as read
        </button>
      </Section>
      <Decisions />
    </>
  );
}

/** The review on paper: the browser prints it, or makes a PDF of it. */
export function PrintView() {
  useEffect(() => {
    if (!printing.value) return;
    const timer = setInterval(() => {
      if (document.querySelector(".print div.seen")) return; // a picture is not here yet
      clearInterval(timer);
      print();
    }, 200);
    return () => clearInterval(timer);
  }, [printing.value]);
  const now = state.value;
  if (!printing.value || !now) return null;
  const revision = revisionNow(now);
  return (
    <article class="print" aria-label="The review on paper">
      <button type="button" class="quiet no-print" onClick={() => (printing.value = false)}>
        Back to the room
      </button>
      <h1>{now.name}</h1>
      <p>
        Pins: {now.pins.length}. Decisions: {now.decisions.length}. Event {String(now.sequence)}
        .
      </p>
      {now.decisions.map((one) => (
        <section key={String(numberOf(one))}>
          <h2>{verdict(one, revision)}</h2>
          <p>
            {byOf(one.stamp)}, {timeOf(one.stamp)}. {one.note}
          </p>
          <Picture what={{ decision: numberOf(one) }} alt="What the decision was about" />
          <p class="hash">SHA-256 {one.hash}</p>
        </section>
      ))}
      {now.pins.map((pin) => (
        <section key={String(numberOf(pin))}>
          <h2>
            Pin {pinLabel(numberOf(pin))}, {pin.resolved ? "resolved" : "open"}, revision{" "}
            {pin.seen?.revision ?? 0}
          </h2>
          <Picture what={{ pin: numberOf(pin) }} alt={`What ${byOf(pin.stamp)} saw`} />
          <ul>
            {pin.notes.map((note) => (
              <Said key={String(numberOf(note))} note={note} />
            ))}
          </ul>
        </section>
      ))}
    </article>
  );
}
