// SPDX-License-Identifier: MIT
// What is said in a room: pins with their threads, decisions, revisions, and all of it on paper.
import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import {
  RoomRole,
  type Decision,
  type Note,
  type Pin,
  type Scene,
  type Stroke,
} from "../gen/relight_pb";
import { anchors } from "../room/anchored";
import { anchorText } from "../room/anchor";
import { act, edit } from "../room/edits";
import { alone, isNew, markRead, mayReview, role, roomId, state, watched } from "../room/here";
import { lookAgain, made, madeKey } from "../room/made";
import { drawingOf, forgetPresent, hashOf } from "../room/pictures";
import { PICTURE, putDown, sceneSeen, showAlone } from "../room/share";
import { lookAlone } from "../room/session";
import { sameJson } from "../room/convert";
import { stands, verdict } from "../room/verdict";
import { Choice, Section, useEscape, useFocus } from "./controls";
import { copyLink } from "./copy";
import { draftOf, sendDraft } from "./drafts";
import {
  byOf,
  comparing,
  filter,
  newPin,
  numberOf,
  openPin,
  pinLabel,
  printing,
  revisionNow,
  shownPins,
  timeOf,
  type Filter,
} from "./review-state";
import { Revisions, Variants } from "./revisions";
import { DifferencePicture, MarksOver, Picture } from "./room-picture";
import { dropStroke, refusedStrokes, sendAgain } from "./strokes";
import { client, fault } from "./store";

const isOwn = (stamp: { by: string } | undefined) =>
  role.value === RoomRole.ROLE_OWNER || stamp?.by === client.hello?.principal;
const strokesOf = (pin: bigint) =>
  (state.value?.strokes ?? []).filter((stroke) => (stroke.line?.pin ?? 0n) === pin);

// Words after @ stand out.
function Text({ text }: { text: string }) {
  return (
    <p>
      {text.split(/((?<![\w.-])@[\w.\u0080-\uffff-]+)/).map((word, i) => (
        <span key={i} class={i % 2 ? "mention" : undefined}>
          {word}
        </span>
      ))}
    </p>
  );
}

function Said({ note }: { note: Note }) {
  if (!note.text) return <li class="hint">erased</li>;
  return (
    <li>
      <small>
        <b>{byOf(note.stamp)}</b> {timeOf(note.stamp)}
        {note.changedUs > 0n && ", changed"}
        {mayReview.value && isOwn(note.stamp) && (
          <button
            type="button"
            class="quiet no-print"
            onClick={() => void act({ erase: { target: numberOf(note) } })}
          >
            Erase
          </button>
        )}
      </small>
      <Text text={note.text} />
    </li>
  );
}

function RefusedStrokes({ pin }: { pin: bigint }) {
  const refused = refusedStrokes(pin);
  if (!refused.length) return null;
  return (
    <p class="hint" role="status">
      {refused.length === 1
        ? "1 stroke was not saved."
        : `${refused.length} strokes were not saved.`}{" "}
      <button type="button" class="quiet" onClick={() => refused.forEach(sendAgain)}>
        Send again
      </button>{" "}
      <button type="button" class="quiet" onClick={() => refused.forEach(dropStroke)}>
        Drop
      </button>
    </p>
  );
}

function Strokes({ pin }: { pin: bigint }) {
  return (
    <>
      <DrawnStrokes strokes={strokesOf(pin)} />
      <RefusedStrokes pin={pin} />
    </>
  );
}

function DrawnStrokes({ strokes }: { strokes: readonly Stroke[] }) {
  const own = strokes.filter((stroke) => isOwn(stroke.stamp));
  if (!strokes.length) return null;
  return (
    <p class="hint">
      {strokes.length === 1 ? "1 stroke is drawn." : `${strokes.length} strokes are drawn.`}{" "}
      {mayReview.value && own.length > 0 && (
        <button
          type="button"
          class="quiet"
          onClick={() => {
            const last = own.at(-1);
            if (last) void act({ erase: { target: numberOf(last) } });
          }}
        >
          Erase the last one
        </button>
      )}
    </p>
  );
}

function Reply({ pin }: { pin: Pin }) {
  const number = numberOf(pin);
  const draft = draftOf(`reply ${number}`);
  const { text, sending } = draft;
  const send = () => {
    if (text.value.trim())
      void sendDraft(draft, (said) => ({ reply: { target: number, text: said } }));
  };
  return (
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
        <button type="submit" class="primary" disabled={sending.value || !text.value.trim()}>
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
  );
}

/** The address of a pin: its thread is open when a page comes by it. */
function linkTo(number: bigint): string {
  const url = new URL(location.href);
  url.searchParams.set("pin", String(number));
  url.hash = "";
  return url.href;
}

function Seen({ pin }: { pin: Pin }) {
  const number = numberOf(pin);
  const copied = useSignal(false);
  const revision = pin.seen?.revision ?? 0;
  const look = () => {
    const past = state.value?.revisions.find((one) => one.number === revision)?.scene;
    lookAlone(true);
    if (past) showAlone(past);
  };
  return (
    <>
      <div class="frame">
        <Picture what={{ pin: number }} alt={`What ${byOf(pin.stamp)} saw`} />
        <MarksOver at={pin.at} strokes={strokesOf(number)} revision={revision} />
      </div>
      <div class="row">
        <small>revision {revision}</small>
        <button type="button" class="quiet" onClick={look}>
          Look at it
        </button>
        <button
          type="button"
          class="quiet"
          onClick={() => void copyLink(linkTo(number)).then((done) => (copied.value = done))}
        >
          {copied.value ? "The link is copied" : "Link to this pin"}
        </button>
      </div>
    </>
  );
}

function Thread({ pin }: { pin: Pin }) {
  const number = numberOf(pin);
  const anchor = anchors.value.get(number);
  const words = anchor ? anchorText(anchor) : "";
  return (
    <div class="thread">
      <Seen pin={pin} />
      {words && (
        <p class={anchor?.state === "lost" ? "warning" : "hint"} role="status">
          {words}
        </p>
      )}
      <Strokes pin={number} />
      <ul>
        {pin.notes.map((note) => (
          <Said key={String(numberOf(note))} note={note} />
        ))}
      </ul>
      {mayReview.value && <Reply pin={pin} />}
    </div>
  );
}

function PinRow({ pin }: { pin: Pin }) {
  const number = numberOf(pin);
  const open = openPin.value === number;
  const lost = anchors.value.get(number)?.state === "lost";
  const row = useRef<HTMLButtonElement>(null);
  useEffect(() => {
    if (open) row.current?.scrollIntoView({ block: "nearest" });
  }, [open]);
  return (
    <li class={`pin-row ${pin.resolved ? "resolved" : ""}`}>
      <button
        ref={row}
        type="button"
        class="pin-title"
        aria-expanded={open}
        onClick={() => (openPin.value = open ? null : number)}
      >
        <span class="pin-number">{pinLabel(number)}</span>
        <span class="pin-text">{pin.notes[0]?.text || "erased"}</span>
        {lost && <small title="It cannot be placed on this model">no place</small>}
        {pin.notes.length > 1 && <small>{pin.notes.length - 1}</small>}
        {isNew(pin) && <i class="unread" role="img" aria-label="unread" />}
      </button>
      {open && <Thread pin={pin} />}
    </li>
  );
}

function NewPin() {
  const draft = draftOf("new pin");
  const { text, sending } = draft;
  const at = newPin.value;
  if (!at) return null;
  const place = async () => {
    const [x, y, z] = at.position;
    const room = roomId.value;
    putDown();
    const answer = await sendDraft(draft, (said) => ({
      pin: { text: said, at: { ...at, position: { x, y, z } }, scene: sceneSeen() },
    }));
    if (!answer || roomId.value !== room) return;
    if (newPin.value === at) newPin.value = null;
    if (filter.value === "resolved") filter.value = "open"; // the new one is
    openPin.value = answer.sequence;
  };
  return (
    <form
      class="new-pin"
      onSubmit={(event) => {
        event.preventDefault();
        if (text.value.trim()) void place();
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
            void place();
        }}
      />
      <div class="row">
        <button type="submit" class="primary" disabled={sending.value || !text.value.trim()}>
          Place the pin
        </button>
        <button type="button" class="quiet" onClick={() => (newPin.value = null)}>
          Cancel
        </button>
      </div>
    </form>
  );
}

// ---- decisions

function DecisionRow({ one, now, last }: { one: Decision; now: number; last: boolean }) {
  const number = numberOf(one);
  const changed = !stands(one, now, made.value);
  return (
    <li class={one.approve ? "approved" : "rejected"}>
      <b>{verdict(one, now, made.value)}</b>
      <small>
        {byOf(one.stamp)}, {timeOf(one.stamp)}
      </small>
      {one.note && <p>{one.note}</p>}
      {changed && last && <DifferencePicture a={{ decision: number }} b={{}} />}
      {changed && (
        <button
          type="button"
          class="quiet"
          onClick={() => (comparing.value = { a: { decision: number }, b: {} })}
        >
          Compare with now
        </button>
      )}
    </li>
  );
}

// What a person was shown and asked about.
interface Asked {
  approve: boolean;
  scene: Scene;
  made: string;
}
const isStale = (asked: Asked) =>
  asked.made !== madeKey.value || !sameJson(asked.scene, state.value?.scene);

/** A decision is about the room's scene and the picture of it that the person sees here: the daemon
 * refuses it where the model has another bake by then. */
function Decide() {
  const note = useSignal("");
  const about = useSignal<Asked | null>(null); // null: nothing is asked
  const sending = useSignal(false); // it is not made a second time
  const ask = (approve: boolean) => {
    putDown();
    const scene = state.value?.scene;
    if (scene) about.value = { approve, scene, made: madeKey.value };
  };
  const decide = async ({ approve, scene }: Asked) => {
    const room = roomId.value;
    const { png, drawn } = await drawingOf({}, PICTURE); // as Picture has it
    const pictureHash = await hashOf(png);
    if (roomId.value !== room) return;
    about.value = null;
    try {
      await edit({ decide: { approve, note: note.value.trim(), scene, pictureHash, drawn } });
    } catch (error) {
      forgetPresent();
      await lookAgain();
      throw error;
    }
    note.value = "";
  };
  const decideOnce = async (asked: Asked) => {
    if (sending.value) return;
    sending.value = true;
    await decide(asked).catch(fault);
    sending.value = false;
  };
  if (alone.value)
    return <p class="hint">You look around alone. Go back to all to decide about it.</p>;
  if (watched.value)
    return <p class="hint">You see another’s own scene. Stop following to decide.</p>;
  const asked = about.value;
  const word = asked?.approve ? "Approve" : "Reject";
  return (
    <form class="decide" onSubmit={(event) => event.preventDefault()}>
      <input
        aria-label="Note of the decision"
        placeholder="Note"
        value={note.value}
        onInput={(event) => (note.value = event.currentTarget.value)}
      />
      {asked === null ? (
        <div class="row">
          <button type="button" class="primary" onClick={() => ask(true)}>
            Approve
          </button>
          <button type="button" onClick={() => ask(false)}>
            Reject
          </button>
        </div>
      ) : (
        <>
          {isStale(asked) ? (
            <p class="warning" role="status">
              The scene or its model has changed: look at it again, then decide.
            </p>
          ) : (
            <Picture what={{}} alt="What the decision is about" size={PICTURE} />
          )}
          <div class="row">
            {isStale(asked) ? (
              <button type="button" class="primary" onClick={() => ask(asked.approve)}>
                Look again
              </button>
            ) : (
              <button
                type="button"
                class="primary"
                disabled={sending.value}
                onClick={() => void decideOnce(asked)}
              >
                {word} this picture
              </button>
            )}
            <button type="button" class="quiet" onClick={() => (about.value = null)}>
              Cancel
            </button>
          </div>
        </>
      )}
    </form>
  );
}

function Decisions() {
  const now = state.value;
  if (!now) return null;
  const revision = revisionNow(now);
  return (
    <Section title="Decisions">
      <ul class="decisions">
        {now.decisions.map((one, i) => (
          <DecisionRow
            key={String(numberOf(one))}
            one={one}
            now={revision}
            last={i === now.decisions.length - 1}
          />
        ))}
        {!now.decisions.length && <li class="hint">Nothing is decided yet.</li>}
      </ul>
      {mayReview.value && <Decide />}
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
          {!pins.length && (
            <li class="hint">
              No pin is here.{" "}
              {mayReview.value && "Pin (or P) and a click on the model place one."}
            </li>
          )}
        </ul>
        <Strokes pin={0n} />
        <button type="button" class="quiet" onClick={markRead}>
          Mark all as read
        </button>
      </Section>
      <Decisions />
      <Revisions />
      <Variants />
    </>
  );
}

// ---- on paper

function PrintedDecision({ one, now }: { one: Decision; now: number }) {
  const number = numberOf(one);
  return (
    <section>
      <h2>{verdict(one, now, made.value)}</h2>
      <p>
        {byOf(one.stamp)}, {timeOf(one.stamp)}. {one.note}
      </p>
      <div class="pair">
        <Picture what={{ decision: number }} alt="What the decision was about" />
        {!stands(one, now, made.value) && (
          <>
            <Picture what={{}} alt="The scene now" />
            <DifferencePicture
              a={{ decision: number }}
              b={{}}
              size={{ width: 480, height: 360 }}
            />
          </>
        )}
      </div>
      <p class="hash">SHA-256 {one.hash}</p>
    </section>
  );
}

/** The review on paper: the browser prints it, or makes a PDF of it. */
export function PrintView() {
  useEffect(() => {
    if (!printing.value) return;
    const timer = setInterval(() => {
      if (document.querySelector(".print .wait")) return; // a picture is not here yet
      clearInterval(timer);
      print();
    }, 200);
    return () => clearInterval(timer);
  }, [printing.value]);
  const now = state.value;
  const isThere = printing.value && now !== null;
  const node = useRef<HTMLElement>(null);
  useEscape(isThere, () => (printing.value = false));
  useFocus(node, isThere);
  if (!printing.value || !now) return null;
  const revision = revisionNow(now);
  return (
    <article ref={node} class="print" aria-label="The review on paper" tabIndex={-1}>
      <button type="button" class="quiet no-print" onClick={() => (printing.value = false)}>
        Back to the room
      </button>
      <h1>{now.name}</h1>
      <p>
        Pins: {now.pins.length}. Decisions: {now.decisions.length}. Revisions:{" "}
        {now.revisions.length}. Event {String(now.sequence)}.
      </p>
      {now.decisions.map((one) => (
        <PrintedDecision key={String(numberOf(one))} one={one} now={revision} />
      ))}
      {now.pins.map((pin) => (
        <section key={String(numberOf(pin))}>
          <h2>
            Pin {pinLabel(numberOf(pin))}, {pin.resolved ? "resolved" : "open"}, revision{" "}
            {pin.seen?.revision ?? 0}
          </h2>
          <div class="frame">
            <Picture what={{ pin: numberOf(pin) }} alt={`What ${byOf(pin.stamp)} saw`} />
            <MarksOver
              at={pin.at}
              strokes={strokesOf(numberOf(pin))}
              revision={pin.seen?.revision ?? 0}
            />
          </div>
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
