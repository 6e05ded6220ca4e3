// SPDX-License-Identifier: MIT
// Rooms: the list of them, and the bar of the one that the page is in.
import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { RoomRole, type Participant } from "../gen/relight_pb";
import { act } from "../room/edits";
import {
  alone,
  colorOf,
  conflict,
  css,
  follows,
  leads,
  mayReview,
  me,
  myName,
  others,
  people,
  role,
  rooms,
  roomsMore,
  setName,
  state,
  unread,
  waiting,
  watched,
} from "../room/here";
import { createRoom, enter, follow, lead, leave, listRooms, lookAlone } from "../room/session";
import { Drawer, Icon, IconButton } from "./controls";
import { Invite } from "./invite";
import { mayEdit } from "./store";
import { covered, jumpToPin, openPin, printing, tool } from "./review-state";

const ROLES: Record<number, string> = {
  [RoomRole.ROLE_VIEWER]: "viewer",
  [RoomRole.ROLE_REVIEWER]: "reviewer",
  [RoomRole.ROLE_OWNER]: "owner",
};

function NewRoom({ made }: { made: () => void }) {
  const name = useSignal("");
  return (
    <form
      class="bring"
      onSubmit={(event) => {
        event.preventDefault();
        if (!name.value.trim()) return;
        void createRoom(name.value.trim()).then((done) => done && made());
      }}
    >
      <label>
        Your name
        <input value={myName.value} onChange={(event) => setName(event.currentTarget.value)} />
      </label>
      {mayEdit.value ? (
        <>
          <label>
            A new room about this picture
            <input
              value={name.value}
              placeholder="Bunny in jade"
              onInput={(event) => (name.value = event.currentTarget.value)}
            />
          </label>
          <button type="submit" class="primary" disabled={!name.value.trim()}>
            Create the room
          </button>
        </>
      ) : (
        <p class="hint">This token may not make a room (scope edit).</p>
      )}
    </form>
  );
}

export function Rooms({ close }: { close: () => void }) {
  useEffect(() => void listRooms(), []);
  const all = rooms.value ?? [];
  return (
    <Drawer title="Rooms" closeLabel="Close the list of rooms" close={close}>
      <ul class="models">
        {all.map((room) => (
          <li key={room.room}>
            <button
              type="button"
              class="model"
              onClick={() => {
                enter(room.room);
                close();
              }}
            >
              <span>
                <b>
                  {room.name}
                  {unread(room) && <i class="unread" role="img" aria-label="unread" />}
                </b>
                <small>
                  {ROLES[room.role]}
                  {room.present > 0 && ` · ${room.present} here`}
                  {room.closed && " · closed"}
                  {` · ${new Date(Number(room.changedUs / 1000n)).toLocaleString()}`}
                </small>
              </span>
            </button>
          </li>
        ))}
        {rooms.value?.length === 0 && <li class="hint">There is no room yet.</li>}
        {roomsMore.value && (
          <li class="hint">
            These are the {all.length} rooms that changed last. A link to an older room opens
            it.
          </li>
        )}
      </ul>
      <NewRoom made={close} />
    </Drawer>
  );
}

const initials = (name: string) =>
  name
    .split(/\s+/)
    .map((word) => word[0] ?? "")
    .join("")
    .slice(0, 2)
    .toUpperCase() || "?";

const nameOf = (person: Participant) => person.name || person.by;

// What a person does, beside the name and the role.
function doing(person: Participant): string {
  const led = people.value.get(person.follows);
  const whom = person.follows === me.value ? "you" : led ? nameOf(led) : "";
  return [
    ROLES[person.role] ?? "",
    person.alone ? "looks around alone" : "",
    person.leads ? "leads" : "",
    whom ? `follows ${whom}` : "",
    person.handParts.length ? `moves ${person.handParts.join(", ")}` : "",
  ]
    .filter(Boolean)
    .join(", ");
}

function Person({ person }: { person: Participant }) {
  const followed = follows.value === person.key;
  const name = nameOf(person);
  const words = `${name}, ${doing(person)}. ${followed ? "Stop following" : "Follow"}`;
  const marks = `${person.alone ? "alone" : ""} ${person.follows === me.value ? "with-me" : ""} ${
    person.handParts.length ? "moves" : ""
  }`;
  return (
    <button
      type="button"
      class={`person ${marks}`}
      aria-pressed={followed}
      style={{ "--own": css(person.color || colorOf(person.key)) }}
      title={words}
      onClick={() => follow(person.key)}
    >
      {initials(name)}
      <span class="for-readers">{words}</span>
    </button>
  );
}

function Following() {
  const led = people.value.get(follows.value);
  const seen = watched.value;
  if (!led) return null;
  return (
    <small role="status">
      {seen ? `You see what ${nameOf(seen)} sees alone.` : `The camera is ${nameOf(led)}’s.`}{" "}
      <button type="button" class="quiet" onClick={() => follow(led.key)}>
        Stop following
      </button>
    </small>
  );
}

const KEYS: readonly [string, string][] = [
  ["P", "place a pin"],
  ["D", "draw on the model"],
  ["J, K", "next and previous pin"],
  ["R", "reply"],
  ["E", "resolve or reopen"],
  ["A", "look around alone, back to all"],
  ["L", "lead: the others take your camera"],
  ["?", "these keys"],
];

// Sliders and check boxes take no letters.
function isTyping(at: EventTarget | null): boolean {
  if (at instanceof HTMLInputElement) return at.type !== "range" && at.type !== "checkbox";
  return at instanceof HTMLTextAreaElement || at instanceof HTMLSelectElement;
}

function useRoomKeys(help: { value: boolean }): void {
  useEffect(() => {
    const stop = new AbortController();
    addEventListener(
      "keydown",
      (event) => {
        const typing = isTyping(event.target);
        if (!state.value || covered.value || typing) return;
        if (event.ctrlKey || event.metaKey || event.altKey) return;
        const key = event.key.toLowerCase();
        if (key === "p" && mayReview.value) take("pin");
        else if (key === "d" && mayReview.value) take("draw");
        else if (key === "escape") {
          tool.value = "none";
          help.value = false;
        } else if (key === "j") jumpToPin(1);
        else if (key === "k") jumpToPin(-1);
        else if (key === "a") lookAlone(!alone.value);
        else if (key === "l" && mayReview.value) lead(!leads.value);
        else if (key === "?") help.value = !help.value;
        else if (key === "e" && openPin.value) toggle(openPin.value);
        else if (key === "r" && openPin.value)
          document.querySelector<HTMLTextAreaElement>("#reply")?.focus();
        else return;
        event.preventDefault();
      },
      { signal: stop.signal },
    );
    return () => stop.abort();
  }, []);
}
function toggle(number: bigint): void {
  const pin = state.value?.pins.find((one) => one.stamp?.sequence === number);
  if (pin && mayReview.value) void act({ status: { pin: number, resolved: !pin.resolved } });
}

// --bar of the stage is the height of the bar: messages lie below it.
function useHeight(bar: { current: HTMLDivElement | null }, isThere: boolean): void {
  useEffect(() => {
    const node = bar.current;
    if (!node) return undefined;
    const observer = new ResizeObserver(() =>
      node.parentElement?.style.setProperty("--bar", `${node.offsetHeight}px`),
    );
    observer.observe(node);
    return () => observer.disconnect();
  }, [isThere]);
}

/** Takes a tool, or lays it down. */
function take(which: "pin" | "draw"): void {
  tool.value = tool.value === which ? "none" : which;
}
const TOOLS = [
  ["pin", "Pin"],
  ["draw", "Draw"],
] as const;

export function RoomBar() {
  const inviting = useSignal(false);
  const help = useSignal(false);
  useRoomKeys(help);
  const bar = useRef<HTMLDivElement>(null);
  useHeight(bar, state.value !== null);
  const now = state.value;
  if (!now) return null;
  return (
    <div ref={bar} class="room-bar" role="region" aria-label="Room">
      <b class="room-name">{now.name}</b>
      {now.closed && <small>closed</small>}
      <div class="people" role="group" aria-label="People">
        <span
          class="person me"
          style={{ "--own": css(colorOf(me.value)) }}
          title={`You, ${ROLES[role.value] ?? ""}`}
        >
          {initials(myName.value || "you")}
        </span>
        {others.value.map((person) => (
          <Person key={String(person.key)} person={person} />
        ))}
      </div>
      <Following />
      {waiting.value > 1 && <small role="status">{waiting.value} changes wait</small>}
      <span class="gap" />
      {mayReview.value &&
        TOOLS.map(([which, label]) => (
          <button
            key={which}
            type="button"
            aria-pressed={tool.value === which}
            onClick={() => take(which)}
          >
            {label}
          </button>
        ))}
      {mayReview.value && others.value.length > 0 && (
        <button
          type="button"
          aria-pressed={leads.value}
          title="The others take your camera"
          onClick={() => lead(!leads.value)}
        >
          Lead
        </button>
      )}
      <button type="button" aria-pressed={alone.value} onClick={() => lookAlone(!alone.value)}>
        {alone.value ? "Back to all" : "Look alone"}
      </button>
      {role.value === RoomRole.ROLE_OWNER && (
        <button
          type="button"
          aria-expanded={inviting.value}
          onClick={() => (inviting.value = !inviting.value)}
        >
          Invite
        </button>
      )}
      <button type="button" onClick={() => (printing.value = true)}>
        Print
      </button>
      <button
        type="button"
        class="keys-button"
        aria-label="Keys"
        title="Keys (?)"
        aria-expanded={help.value}
        onClick={() => (help.value = !help.value)}
      >
        ?
      </button>
      <IconButton icon="close" label="Leave the room" onClick={leave} />
      {conflict.value && (
        <p class="conflict" role="alert">
          {conflict.value}
          <button type="button" class="quiet" onClick={() => (conflict.value = "")}>
            Close
          </button>
        </p>
      )}
      {inviting.value && <Invite close={() => (inviting.value = false)} />}
      {help.value && (
        <dl class="popover keys">
          {KEYS.map(([key, does]) => (
            <div key={key}>
              <dt>
                <kbd>{key}</kbd>
              </dt>
              <dd>{does}</dd>
            </div>
          ))}
        </dl>
      )}
    </div>
  );
}

export function RoomsButton(props: { open: boolean; onClick: () => void }) {
  const some = (rooms.value ?? []).some(unread);
  return (
    <button
      type="button"
      class="model-button rooms-button"
      aria-expanded={props.open}
      onClick={props.onClick}
    >
      <Icon name="compare" /> <span>Rooms</span>
      {some && <i class="unread" role="img" aria-label="unread" />}
    </button>
  );
}
