// SPDX-License-Identifier: MIT
// Rooms: the list of them, and the bar of the one that the page is in.
import { useSignal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { RoomRole, type Participant } from "../gen/relight_pb";
import {
  act,
  alone,
  createRoom,
  css,
  colorOf,
  conflict,
  enter,
  follow,
  follows,
  invite,
  leave,
  listRooms,
  lookAlone,
  mayReview,
  me,
  myName,
  others,
  role,
  rooms,
  setName,
  state,
  unread,
  waiting,
} from "../room/session";
import { Icon, IconButton } from "./controls";
import { jumpToPin, openPin, pinMode, printing } from "./review-panel";
import { fault } from "./store";

const ROLES: Record<number, string> = {
  [RoomRole.ROLE_VIEWER]: "viewer",
  [RoomRole.ROLE_REVIEWER]: "reviewer",
  [RoomRole.ROLE_OWNER]: "owner",
};

export function Rooms({ close }: { close: () => void }) {
  const name = useSignal("");
  useEffect(() => void listRooms(), []);
  const all = rooms.value ?? [];
  return (
    <aside class="drawer" aria-label="Rooms">
      <header>
        <h2>Rooms</h2>
        <IconButton icon="close" label="Close the list of rooms" onClick={close} />
      </header>
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
                  {unread(room) && <i class="unread" aria-label="unread" />}
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
        {!all.length && <li class="hint">There is no room yet.</li>}
      </ul>
      <form
        class="bring"
        onSubmit={(event) => {
          event.preventDefault();
          if (!name.value.trim()) return;
          void createRoom(name.value.trim()).then(close);
        }}
      >
        <label>
          Your name
          <input
            value={myName.value}
            onChange={(event) => setName(event.currentTarget.value)}
          />
        </label>
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
      </form>
    </aside>
  );
}

const initials = (name: string) =>
  name
    .split(/\s+/)
    .map((word) => word[0] ?? "")
    .join("")
    .slice(0, 2)
    .toUpperCase() || "?";

function Person({ person }: { person: Participant }) {
  const followed = follows.value === person.key;
  const name = person.name || person.by;
  return (
    <button
      type="button"
      class={`person ${person.alone ? "alone" : ""}`}
      aria-pressed={followed}
      style={{ "--own": css(person.color || colorOf(person.key)) }}
      title={`${name}, ${ROLES[person.role] ?? ""}${person.alone ? ", looks around alone" : ""}. ${
        followed ? "Stop following" : "Follow"
      }`}
      onClick={() => follow(person.key)}
    >
      {initials(name)}
      <span class="for-readers">{name}</span>
    </button>
  );
}

function Invite({ close }: { close: () => void }) {
  const name = useSignal("");
  const may = useSignal(RoomRole.ROLE_REVIEWER);
  const link = useSignal("");
  return (
    <form
      class="popover"
      aria-label="Invite"
      onSubmit={(event) => {
        event.preventDefault();
        void invite(name.value || "guest", may.value, 14).then((url) => {
          link.value = url;
          if (url) void navigator.clipboard.writeText(url).catch(() => undefined);
        }, fault);
      }}
    >
      <label>
        For whom
        <input
          value={name.value}
          onInput={(event) => (name.value = event.currentTarget.value)}
        />
      </label>
      <label>
        May
        <select
          value={may.value}
          onChange={(event) => (may.value = Number(event.currentTarget.value) as RoomRole)}
        >
          <option value={RoomRole.ROLE_REVIEWER}>review</option>
          <option value={RoomRole.ROLE_VIEWER}>look</option>
        </select>
      </label>
      <button type="submit" class="primary">
        Make a link for 14 days
      </button>
      {link.value && (
        <>
          <input class="link" aria-label="Invitation" readOnly value={link.value} />
          <p class="hint">It is copied, and shown this once. Whoever has it is let in.</p>
        </>
      )}
      <button type="button" class="quiet" onClick={close}>
        Close
      </button>
    </form>
  );
}

const KEYS: readonly [string, string][] = [
  ["P", "place a pin"],
  ["J, K", "next and previous pin"],
  ["R", "reply"],
  ["E", "resolve or reopen"],
  ["A", "look around alone, back to all"],
  ["?", "these keys"],
];

function useRoomKeys(help: { value: boolean }): void {
  useEffect(() => {
    const stop = new AbortController();
    addEventListener(
      "keydown",
      (event) => {
        const at = event.target;
        const typing =
          at instanceof HTMLInputElement ||
          at instanceof HTMLTextAreaElement ||
          at instanceof HTMLSelectElement;
        if (!state.value || typing || event.ctrlKey || event.metaKey || event.altKey) return;
        const key = event.key.toLowerCase();
        if (key === "p" && mayReview.value) pinMode.value = !pinMode.value;
        else if (key === "escape") {
          pinMode.value = false;
          help.value = false;
        } else if (key === "j") jumpToPin(1);
        else if (key === "k") jumpToPin(-1);
        else if (key === "a") lookAlone(!alone.value);
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

export function RoomBar() {
  const inviting = useSignal(false);
  const help = useSignal(false);
  useRoomKeys(help);
  const now = state.value;
  if (!now) return null;
  return (
    <div class="room-bar" role="region" aria-label="Room">
      <b class="room-name">{now.name}</b>
      {now.closed && <small>closed</small>}
      <div class="people" aria-label="People">
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
      {waiting.value > 1 && <small role="status">{waiting.value} changes wait</small>}
      <span class="gap" />
      {mayReview.value && (
        <button
          type="button"
          aria-pressed={pinMode.value}
          onClick={() => (pinMode.value = !pinMode.value)}
        >
          Pin
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

export function RoomsButton({ open }: { open: { value: boolean } }) {
  const some = (rooms.value ?? []).some(unread);
  return (
    <button
      type="button"
      class="model-button"
      aria-expanded={open.value}
      onClick={() => (open.value = !open.value)}
    >
      <Icon name="compare" /> <span>Rooms</span>
      {some && <i class="unread" aria-label="unread" />}
    </button>
  );
}
