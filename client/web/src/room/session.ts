// SPDX-License-Identifier: MIT
// The seat in a review room: its state and events, the people in it; rooms are listed, made,
// entered and left.
import { create, fromBinary } from "@bufbuild/protobuf";
import { batch, effect } from "@preact/signals";
import {
  ErrorCode,
  EventKind,
  EventSchema,
  PinSchema,
  PresenceSchema,
  RoomCreateAnswerSchema,
  RoomCreateRequestSchema,
  RoomEventsSchema,
  RoomGetAnswerSchema,
  RoomGetRequestSchema,
  RoomListAnswerSchema,
  RoomListRequestSchema,
  RoomStateSchema,
  SubscribeRequestSchema,
  RoomRole,
  type RoomEvent,
} from "../gen/relight_pb";
import { busyMs, whenFree } from "../protocol/busy";
import { DisconnectedError, PageError, RelightError } from "../protocol/errors";
import { Type } from "../protocol/frame";
import {
  MADE,
  beginHistory,
  change,
  client,
  connection,
  fault,
  fine,
  keepAddress,
  roomHistory,
  scene,
  showAddress,
  viewer,
} from "../ui/store";
import { filter, forgetReview, openPin } from "../ui/review-state";
import { orbitOf, PARTS, sameJson } from "./convert";
import { answered, AUTHOR, edit, pump } from "./edits";
import {
  alone,
  beginReading,
  colorOf,
  conflict,
  follows,
  leads,
  leaveRead,
  mayReview,
  me,
  myName,
  people,
  role,
  roomId,
  rooms,
  roomsMore,
  seat,
  state,
} from "./here";
import { forgetTold, tell } from "./presence";
import {
  forgetRoom,
  putDown,
  showParts,
  shownScene,
  showRoom,
  takeHand,
  useRoom,
} from "./share";

// ---- the list

const ROOMS = Symbol("rooms");
const askRooms = () =>
  client.request(Type.RoomList, RoomListRequestSchema, {}, RoomListAnswerSchema);
let listing = 0; // grows with every reading of the list: the newest waits for a busy daemon

export async function listRooms(): Promise<void> {
  const mine = ++listing;
  try {
    const { message } = await whenFree(askRooms, (error) => {
      if (mine === listing) fault(error, ROOMS, true);
      return mine === listing;
    });
    if (mine !== listing) return; // a newer one was asked for meanwhile
    rooms.value = message.rooms;
    roomsMore.value = message.more;
    fine(ROOMS);
  } catch (error) {
    if (client.hello && mine === listing) fault(error, ROOMS);
  }
}

let creating: Promise<boolean> | null = null;
/** Makes a room and goes into it, once while it is being made; false where it was refused. */
export function createRoom(name: string): Promise<boolean> {
  return (creating ??= makeRoom(name).finally(() => (creating = null)));
}
async function makeRoom(name: string): Promise<boolean> {
  try {
    const first = await shownScene();
    const { message } = await client.request(
      Type.RoomCreate,
      RoomCreateRequestSchema,
      { name, scene: first, me: myName.value },
      RoomCreateAnswerSchema,
    );
    enter(message.room);
    return true;
  } catch (error) {
    fault(error);
    return false;
  }
}

function sitIn(id: string): void {
  roomId.value = id;
  sit();
}
/** Goes into a room; the address keeps it. */
export function enter(id: string): void {
  const url = new URL(location.href);
  url.searchParams.set("room", id);
  url.searchParams.delete("pin");
  history.pushState(MADE, "", url);
  leaveRead();
  leaveSeat();
  sitIn(id);
}
export function leave(): void {
  const url = new URL(location.href);
  url.searchParams.delete("room");
  url.searchParams.delete("pin");
  history.pushState(MADE, "", url);
  goOut();
  beginHistory();
}
function goOut(): void {
  leaveRead();
  leaveSeat();
  roomId.value = "";
  void listRooms();
}

if (roomId.value) history.replaceState(MADE, "", location.href);
// Back and Forward enter and leave the room that the address names. In the same room they change no
// scene; a link that a person opened there does.
addEventListener("popstate", ({ state: entry }) => {
  const named = new URLSearchParams(location.search).get("room") ?? "";
  const before = roomId.value;
  if (named && named === before) {
    if (entry === null) showAddress();
    keepAddress();
  } else if (named) {
    leaveRead();
    leaveSeat();
    sitIn(named);
  } else if (before) {
    goOut();
    showAddress();
    beginHistory();
  }
});

// ---- the seat

let lastSequence = 0n;
const SEAT = Symbol("seat");
let lost = false; // the connection was lost since the last state

function leaveSeat(): void {
  forgetRoom();
  forgetTold();
  forgetReview();
  if (seat.id) client.cancel(seat.id);
  seat.id = 0n;
  lastSequence = 0n;
  state.value = null;
  people.value = new Map();
  alone.value = false;
  leads.value = false;
  follows.value = leader = 0n;
  role.value = RoomRole.ROLE_NONE;
  me.value = 0n;
  conflict.value = "";
}

function sit(): void {
  const id = roomId.value;
  if (!id || !client.hello) return;
  const mine = (seat.id = client.stream(
    Type.Subscribe,
    SubscribeRequestSchema,
    { room: id, me: { name: myName.value, color: colorOf(me.value) } },
    EventSchema,
    ({ message, payload }) => {
      if (seat.id !== mine) return;
      if (message.participant) me.value = message.participant;
      if (message.role) role.value = message.role;
      if (message.kind === EventKind.EVENT_ROOM_STATE) takeState(payload);
      else if (message.kind === EventKind.EVENT_ROOM_EVENTS) takeEvents(payload);
      else if (message.kind === EventKind.EVENT_ROOM_PRESENCE)
        takePresence(payload, message.lost);
    },
    (error) => {
      if (seat.id !== mine || error instanceof DisconnectedError) return;
      const wait = busyMs(error);
      if (error) fault(error, SEAT, wait !== null);
      if (wait !== null) setTimeout(() => seat.id === mine && sit(), wait);
      const gone =
        error instanceof RelightError &&
        (error.code === ErrorCode.ERROR_NOT_FOUND || error.code === ErrorCode.ERROR_FORBIDDEN);
      if (gone) leave();
    },
  ));
}

function takeState(payload: Uint8Array): void {
  const next = fromBinary(RoomStateSchema, payload);
  const first = state.value === null;
  fine(SEAT);
  state.value = next;
  lastSequence = next.sequence;
  if (first) {
    beginReading(next.room);
    openLinked();
  }
  showRoom();
  tell();
}
// A link to a pin opens its thread, whatever the filter.
function openLinked(): void {
  const number = new URLSearchParams(location.search).get("pin") ?? "";
  const pin = state.value?.pins.find((one) => String(one.stamp?.sequence) === number);
  if (!pin) return;
  filter.value = "all";
  openPin.value = pin.stamp?.sequence ?? null;
}
function step(word: "undo" | "redo"): void {
  if (!mayReview.value) return;
  putDown(); // what the hand holds is the step to undo
  edit(word === "undo" ? { undo: {} } : { redo: {} }).catch((error: unknown) => {
    const none = error instanceof RelightError && error.code === ErrorCode.ERROR_NOT_FOUND;
    fault(none ? new PageError(`There is no change of yours to ${word} here.`) : error);
  });
}

// Alone, undo and redo are this person's own.
const steps = { undo: () => step("undo"), redo: () => step("redo") };
effect(() => {
  const open = mayReview.value;
  roomHistory.value = state.value && !alone.value ? { ...steps, open } : null;
});

let fetching: ReturnType<typeof setTimeout> | undefined;
/** Reads the state anew: what a pin, a decision or an undo changed. */
function fetchState(): void {
  clearTimeout(fetching);
  fetching = setTimeout(() => {
    const id = roomId.value;
    const ask = () =>
      client.request(Type.RoomGet, RoomGetRequestSchema, { room: id }, RoomGetAnswerSchema);
    whenFree(ask, () => id === roomId.value)
      .then(({ message, payload }) => {
        if (id !== roomId.value) return;
        // Older than what is shown. The event behind it may ask for none: a change of the scene.
        if (message.sequence < lastSequence) {
          fetchState();
          return;
        }
        role.value = message.role as RoomRole;
        takeState(payload);
      })
      .catch((error: unknown) => {
        if (!(error instanceof DisconnectedError) && id === roomId.value) fault(error);
      });
  }, 0);
}
useRoom(fetchState, () =>
  answered.room === roomId.value && answered.sequence > lastSequence
    ? answered.sequence
    : lastSequence,
);

function takeEvents(payload: Uint8Array): void {
  for (const event of fromBinary(RoomEventsSchema, payload).events) {
    lastSequence = event.stamp?.sequence ?? lastSequence;
    if (lastSequence <= (state.value?.sequence ?? 0n)) continue; // a state that was read has it
    if (event.action?.scene) takeChange(event);
    else {
      if (event.action?.pin) takePin(event);
      fetchState();
    }
  }
}
// A pin is shown at once; what the room found out about it comes with the state.
function takePin({ action, stamp }: RoomEvent): void {
  const now = state.value;
  const put = action?.pin;
  if (!now || !put || !stamp) return;
  const { at, seen, text } = put;
  const pin = create(PinSchema, { stamp, at, seen, notes: [{ stamp, text }] });
  state.value = { ...now, pins: [...now.pins, pin] };
}
// A change of the scene needs no new state: it says what it changes.
function takeChange({ action, client: author, stamp }: RoomEvent): void {
  const now = state.value;
  const moved = action?.scene;
  if (!now?.scene || !moved?.scene) return;
  const values = moved.parts.map((part) => [part, moved.scene?.[part as keyof object]]);
  const next = { ...now.scene, ...(Object.fromEntries(values) as object) };
  state.value = { ...now, scene: next, sequence: stamp?.sequence ?? now.sequence };
  if (author !== AUTHOR) showParts(moved.parts);
}

function takePresence(payload: Uint8Array, isAll: boolean): void {
  const news = fromBinary(PresenceSchema, payload).participants;
  const next = new Map(isAll ? [] : people.value);
  if (isAll)
    for (const person of people.value.values())
      if (!news.some((one) => one.key === person.key)) takeHand({ ...person, gone: true });
  for (const person of news) {
    if (person.gone) next.delete(person.key);
    else next.set(person.key, person);
    if (person.leads && person.key !== me.value && !people.value.get(person.key)?.leads)
      followLeader(person.key);
  }
  for (const person of news) takeHand(person);
  people.value = next;
  takeLead();
}
// Who asks to be followed is followed until this person, or the leader, stops it.
let leader = 0n;
function followLeader(key: bigint): void {
  if (alone.value || leads.value) return;
  leader = follows.value = key;
  tell();
}
function takeLead(): void {
  if (!follows.value) return;
  const led = people.value.get(follows.value);
  if (!led || (follows.value === leader && !led.leads)) {
    followNobody();
    tell();
    return;
  }
  const frame = viewer?.framed;
  const orbit = frame ? orbitOf(led.camera, frame) : null;
  if (orbit && !sameJson(orbit, scene.value.orbit)) change({ orbit });
}

// Back to the room's camera, at once: the one that was followed is not this person's own.
function followNobody(): void {
  batch(() => {
    follows.value = leader = 0n;
    showParts(["camera"]);
  });
}

export function lookAlone(on: boolean): void {
  putDown();
  alone.value = on;
  if (!on) showParts(PARTS);
  beginHistory();
  tell(on ? {} : { own: null });
}
export function follow(key: bigint): void {
  if (follows.value === key) followNobody();
  else follows.value = key;
  leader = 0n;
  tell();
  takeLead();
}
export function lead(on: boolean): void {
  leads.value = on;
  if (on) follows.value = 0n;
  tell();
}

// ---- following

effect(() => {
  const { is } = connection.value;
  if (is === "ready") {
    if (roomId.peek() && (lost || !seat.id)) sit();
    lost = false;
    void pump();
    if (!roomId.peek()) void listRooms();
  } else if (is !== "refused") lost = true;
  else leaveSeat(); // a link that expired or was revoked: nothing is shown
});
effect(() => {
  void scene.value.orbit;
  if (state.value) tell();
});
addEventListener("beforeunload", () => {
  putDown();
  leaveRead();
});
