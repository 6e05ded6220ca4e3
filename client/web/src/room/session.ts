// SPDX-License-Identifier: MIT
// A review room: what is in it, who is there, and what this page does in it. The scene of the page
// and the scene of the room follow each other, unless the person looks around alone.
import { create, fromBinary, type MessageInitShape } from "@bufbuild/protobuf";
import { computed, effect, signal } from "@preact/signals";
import {
  ErrorCode,
  EventKind,
  EventSchema,
  PresenceSchema,
  RoomActionSchema,
  RoomCreateAnswerSchema,
  RoomCreateRequestSchema,
  RoomEditAnswerSchema,
  RoomEditRequestSchema,
  RoomEventsSchema,
  RoomGetAnswerSchema,
  RoomGetRequestSchema,
  RoomListAnswerSchema,
  RoomListRequestSchema,
  RoomPictureRequestSchema,
  RoomPresenceRequestSchema,
  RoomRole,
  RoomStateSchema,
  ImageAnswerSchema,
  ImageFormat,
  SubscribeRequestSchema,
  type Participant,
  type Pin,
  type RoomEditAnswer,
  type RoomState,
  type RoomSummary,
} from "../gen/relight_pb";
import { DisconnectedError, RelightError } from "../protocol/errors";
import { Type } from "../protocol/frame";
import { upload } from "../protocol/upload";
import {
  change,
  client,
  connection,
  fault,
  info,
  roomHistory,
  scene,
  status,
  viewer,
} from "../ui/store";
import {
  lightsOf,
  orbitOf,
  PARTS,
  sameJson,
  sceneOf,
  withParts,
  type PartName,
  type SceneInit,
} from "./convert";
import { builtinFile } from "./hdr";
import type { Point } from "./pick";

type ActionInit = MessageInitShape<typeof RoomActionSchema>;

const NAME_KEY = "relight-name";
const SEEN_KEY = "relight-room-seen";
const COLORS = [0xe0714f, 0x4f9be0, 0x59b36a, 0xc77bd6, 0xd9a92f, 0x3fb5ae];
const PICTURE = { width: 960, height: 720 }; // of what is kept: pins, decisions

export const rooms = signal<RoomSummary[] | null>(null);
export const roomId = signal(new URLSearchParams(location.search).get("room") ?? "");
export const state = signal<RoomState | null>(null);
export const role = signal(RoomRole.ROLE_NONE);
export const people = signal<ReadonlyMap<bigint, Participant>>(new Map());
export const me = signal(0n);
export const alone = signal(false);
/** Key of the person whose camera is followed; 0: nobody's. */
export const follows = signal(0n);
/** What was not kept of this person's work; empty: all was. */
export const conflict = signal("");
/** Edits that wait for the connection. */
export const waiting = signal(0);
export const myName = signal(localStorage.getItem(NAME_KEY) ?? "");
export const mayReview = computed(
  () => role.value >= RoomRole.ROLE_REVIEWER && !state.value?.closed,
);
export const others = computed(() =>
  [...people.value.values()].filter((person) => person.key !== me.value),
);

export function setName(name: string): void {
  myName.value = name.slice(0, 60);
  localStorage.setItem(NAME_KEY, myName.value);
}
export const colorOf = (key: bigint) => COLORS[Number(key % BigInt(COLORS.length))] ?? 0xffffff;
export const css = (color: number) => `#${color.toString(16).padStart(6, "0")}`;

// ---- what was read: the newest event seen of each room, in this browser

const seenStore = signal<Record<string, number>>(
  JSON.parse(localStorage.getItem(SEEN_KEY) ?? "{}") as Record<string, number>,
);
/** The sequence up to which a room was read before now. */
export const readBefore = signal(0);
export const unread = (room: RoomSummary) =>
  Number(room.sequence) > (seenStore.value[room.room] ?? 0);
export function markRead(): void {
  const now = state.value;
  if (!now) return;
  seenStore.value = { ...seenStore.value, [now.room]: Number(now.sequence) };
  localStorage.setItem(SEEN_KEY, JSON.stringify(seenStore.value));
}
/** Whether a pin has a note that came since the room was left, or since it was looked at. */
export const isNew = (pin: Pin) =>
  pin.notes.some(
    (note) =>
      Number(note.stamp?.sequence ?? 0n) > readBefore.value && !isMine(note.stamp?.name),
  );
const isMine = (name: string | undefined) => name === myName.value;

// ---- the list

export async function listRooms(): Promise<void> {
  try {
    const { message } = await client.request(
      Type.RoomList,
      RoomListRequestSchema,
      {},
      RoomListAnswerSchema,
    );
    rooms.value = message.rooms;
  } catch (error) {
    if (client.hello) fault(error);
  }
}

export async function createRoom(name: string): Promise<void> {
  try {
    const first = await shownScene();
    const { message } = await client.request(
      Type.RoomCreate,
      RoomCreateRequestSchema,
      { name, scene: first, me: myName.value },
      RoomCreateAnswerSchema,
    );
    enter(message.room);
  } catch (error) {
    fault(error);
  }
}

/** Goes into a room; the address keeps it. */
export function enter(id: string): void {
  const url = new URL(location.href);
  url.searchParams.set("room", id);
  history.pushState(null, "", url);
  leaveSeat();
  roomId.value = id;
  sit();
}
export function leave(): void {
  const url = new URL(location.href);
  url.searchParams.delete("room");
  history.pushState(null, "", url);
  markRead();
  leaveSeat();
  roomId.value = "";
  void listRooms();
}

// ---- the seat

let subscription = 0n;
let lastSequence = 0n;
let lost = false; // the connection was lost since the last state

function leaveSeat(): void {
  if (subscription) client.cancel(subscription);
  subscription = 0n;
  lastSequence = 0n;
  state.value = null;
  people.value = new Map();
  shared = null;
  alone.value = false;
  follows.value = 0n;
  roomHistory.value = null;
}

function sit(): void {
  const id = roomId.value;
  if (!id || !client.hello) return;
  const mine = (subscription = client.stream(
    Type.Subscribe,
    SubscribeRequestSchema,
    { room: id, me: { name: myName.value } },
    EventSchema,
    ({ message, payload }) => {
      if (subscription !== mine) return;
      if (message.participant) me.value = message.participant;
      if (message.role) role.value = message.role;
      if (message.kind === EventKind.EVENT_ROOM_STATE)
        takeState(fromBinary(RoomStateSchema, payload));
      else if (message.kind === EventKind.EVENT_ROOM_EVENTS) takeEvents(payload);
      else if (message.kind === EventKind.EVENT_ROOM_PRESENCE)
        takePresence(payload, message.lost);
    },
    (error) => {
      if (subscription !== mine || error instanceof DisconnectedError) return;
      if (error) fault(error);
      if (error instanceof RelightError && error.code === ErrorCode.ERROR_NOT_FOUND) leave();
    },
  ));
}

function takeState(next: RoomState): void {
  const first = state.value === null;
  state.value = next;
  lastSequence = next.sequence;
  if (first) {
    readBefore.value = seenStore.value[next.room] ?? 0;
    roomHistory.value = {
      undo: () => void act({ undo: {} }),
      redo: () => void act({ redo: {} }),
    };
  }
  if (!alone.value && !edits.some((edit) => edit.action.scene)) showParts(PARTS);
  tell({});
}

let fetching: ReturnType<typeof setTimeout> | undefined;
/** Reads the state anew: what a pin, a decision or an undo changed. */
function fetchSoon(ms: number): void {
  clearTimeout(fetching);
  fetching = setTimeout(() => {
    const id = roomId.value;
    client
      .request(Type.RoomGet, RoomGetRequestSchema, { room: id }, RoomGetAnswerSchema)
      .then(({ message, payload }) => {
        // Older than what is shown: the events behind it bring a newer one.
        if (id !== roomId.value || message.sequence < lastSequence) return;
        role.value = message.role;
        takeState(fromBinary(RoomStateSchema, payload));
      })
      .catch((error: unknown) => {
        if (!(error instanceof DisconnectedError)) fault(error);
      });
  }, ms);
}

function takeEvents(payload: Uint8Array): void {
  const now = state.value;
  for (const event of fromBinary(RoomEventsSchema, payload).events) {
    lastSequence = event.stamp?.sequence ?? lastSequence;
    const moved = event.action?.scene;
    if (!moved) {
      fetchSoon(0);
      continue;
    }
    fetchSoon(250);
    if (event.client === AUTHOR || !now?.scene || !moved.scene) continue;
    // What another one does to the scene is shown at once.
    for (const part of moved.parts as PartName[])
      Object.assign(now.scene, { [part]: moved.scene[part] });
    if (!alone.value) showParts(moved.parts);
  }
}

function takePresence(payload: Uint8Array, isAll: boolean): void {
  const next = new Map(isAll ? [] : people.value);
  for (const person of fromBinary(PresenceSchema, payload).participants) {
    if (person.gone) next.delete(person.key);
    else next.set(person.key, person);
  }
  people.value = next;
  const led = follows.value ? next.get(follows.value) : undefined;
  const frame = viewer?.framed;
  const orbit = led && frame ? orbitOf(led.camera, frame) : null;
  if (follows.value && !led) follows.value = 0n;
  if (orbit && !sameJson(orbit, scene.value.orbit)) change({ orbit });
}

/** What others see of this person: a cursor on the surface, whom it follows, its camera. */
export function tell(what: { cursor?: Point | null }): void {
  if (!subscription || !state.value) return;
  const placed = viewer?.placed(scene.value);
  const point = what.cursor;
  client.notify(Type.RoomPresence, RoomPresenceRequestSchema, {
    subscription,
    me: {
      name: myName.value,
      color: colorOf(me.value),
      alone: alone.value,
      follows: follows.value,
      camera: placed && {
        eye: vec(placed.eye),
        target: vec(placed.target),
        up: vec(placed.up),
        fovyDeg: placed.fovyDeg,
      },
      cursor: point ? { ...point, position: vec(point.position) } : undefined,
    },
  });
}
const vec = (v: readonly [number, number, number]) => ({ x: v[0], y: v[1], z: v[2] });

// ---- edits: one at a time, sent again after a lost connection

const AUTHOR = Array.from(crypto.getRandomValues(new Uint8Array(8)), (b) =>
  b.toString(16).padStart(2, "0"),
).join("");
interface Edit {
  action: ActionInit;
  number: bigint;
  sent: boolean;
  done: (answer: RoomEditAnswer) => void;
  failed: (error: unknown) => void;
}
const edits: Edit[] = [];
let lastNumber = 0n;
let pumping = false;

function add(action: ActionInit): Promise<RoomEditAnswer> {
  return new Promise((done, failed) => {
    edits.push({ action, number: ++lastNumber, sent: false, done, failed });
    waiting.value = edits.length;
    void pump();
  });
}

async function pump(): Promise<void> {
  if (pumping) return;
  pumping = true;
  while (edits[0] && client.hello && roomId.value) {
    const edit = edits[0];
    edit.sent = true;
    try {
      const { message } = await client.request(
        Type.RoomEdit,
        RoomEditRequestSchema,
        {
          room: roomId.value,
          action: create(RoomActionSchema, edit.action),
          name: myName.value,
          client: AUTHOR,
          number: edit.number,
        },
        RoomEditAnswerSchema,
      );
      if (message.sequence > lastSequence) lastSequence = message.sequence;
      edit.done(message);
    } catch (error) {
      if (error instanceof DisconnectedError) break; // the same number is done once
      edit.failed(error);
    }
    edits.shift();
    waiting.value = edits.length;
  }
  pumping = false;
}

/** Does something in the room; a refusal is said. */
export async function act(action: ActionInit): Promise<RoomEditAnswer | null> {
  try {
    return await add(action);
  } catch (error) {
    fault(error);
    return null;
  }
}

/** Sends parts of the scene; a change that waits is replaced by the newer one. */
function sendParts(parts: readonly PartName[], next: SceneInit): void {
  const last = edits.at(-1);
  const change = last && !last.sent ? last.action.scene : undefined;
  const all = [...new Set([...parts, ...((change?.parts ?? []) as PartName[])])];
  const values = Object.fromEntries(
    all.map((part) => [part, parts.includes(part) ? next[part] : change?.scene?.[part]]),
  );
  const action: ActionInit = {
    scene: {
      scene: values as SceneInit,
      parts: all,
      // Offline, another one's change must not be overwritten unseen.
      since: client.hello ? 0n : (change?.since ?? lastSequence),
    },
  };
  if (last && change) {
    last.action = action;
    return;
  }
  add(action).catch((error: unknown) => {
    if (error instanceof RelightError && error.code === ErrorCode.ERROR_MISMATCH)
      conflict.value =
        "While you were offline another person changed the same part of the scene. Theirs is shown, " +
        "yours was not kept.";
    else fault(error);
    fetchSoon(0);
  });
}

// ---- the page's scene and the room's

let shared: SceneInit | null = null; // as both have it
const uploads = new Map<string, string>(); // "page:ID" to "env:HASH"
const sending = new Set<string>();

function bringLights(): void {
  for (const { env } of scene.value.lamps) {
    if (!env.startsWith("page:") || uploads.has(env) || sending.has(env)) continue;
    const bytes = builtinFile(env);
    if (!bytes || !client.can("upload")) continue;
    sending.add(env);
    upload(client, `${env.slice(5)}.hdr`, bytes)
      .then((hash) => {
        uploads.set(env, `env:${hash}`);
        share();
      })
      .catch(fault)
      .finally(() => sending.delete(env));
  }
}

function sceneNow(): SceneInit {
  const now = scene.value;
  const lights = lightsOf(now.lamps, uploads) ?? shared?.lights ?? [];
  // A name is known as an id when the model is here.
  const isId = /^[0-9a-f]{32}$/.test(now.model);
  const model = isId ? now.model : (info.value?.model ?? state.value?.scene?.model ?? "");
  const placed = viewer?.framed ? viewer.placed(now) : null;
  const out = sceneOf(now, model, placed, lights, PICTURE);
  if (!placed) out.camera = shared?.camera;
  return out;
}

/** Of a new room: lights of the page are uploaded first. */
async function shownScene(): Promise<SceneInit> {
  for (const { env } of scene.value.lamps) {
    const bytes = uploads.has(env) ? null : builtinFile(env);
    if (bytes) uploads.set(env, `env:${await upload(client, `${env.slice(5)}.hdr`, bytes)}`);
  }
  return sceneNow();
}

/** Sends what differs from the room's scene. */
function share(): void {
  if (!state.value || alone.value || !mayReview.value || !shared) return;
  bringLights();
  const now = sceneNow();
  const before = shared;
  const parts = PARTS.filter(
    (part) => !sameJson(now[part], before[part]) && !(part === "camera" && follows.value),
  );
  if (!parts.length) return;
  shared = now;
  sendParts(parts, now);
}

// The camera of the room waits until the model is here.
let cameraWaits = false;
function showCamera(): void {
  const frame = viewer?.framed;
  const camera = state.value?.scene?.camera;
  cameraWaits = camera !== undefined && !frame;
  const orbit = frame && camera ? orbitOf(camera, frame) : null;
  if (orbit && !follows.value) change({ orbit });
}

function showParts(parts: readonly string[]): void {
  const next = state.value?.scene;
  if (!next) return;
  shared = null; // nothing is sent meanwhile
  change(withParts(scene.value, next, parts, uploads));
  if (parts.includes("camera")) showCamera();
  shared = sceneNow();
}

export function lookAlone(on: boolean): void {
  alone.value = on;
  if (!on) showParts(PARTS);
  tell({});
}
export function follow(key: bigint): void {
  follows.value = follows.value === key ? 0n : key;
  tell({});
}

// ---- pins and pictures

export function pinScene(): SceneInit {
  return sceneNow();
}

// The page's content security policy has no blob: for images.
function dataUrl(png: Uint8Array): Promise<string> {
  return new Promise((resolve, reject) => {
    const reader = new FileReader();
    reader.onload = () => resolve(String(reader.result));
    reader.onerror = () => reject(reader.error ?? new Error("the picture cannot be shown"));
    reader.readAsDataURL(new Blob([png.slice()], { type: "image/png" }));
  });
}

const pictures = new Map<string, Promise<string>>();
/** The picture of a pin or a decision, as a data: address. */
export function pictureOf(what: { pin?: bigint; decision?: bigint }): Promise<string> {
  const key = `${roomId.value}/${String(what.pin ?? "")}/${String(what.decision ?? "")}`;
  let made = pictures.get(key);
  if (!made) {
    made = client
      .request(
        Type.RoomPicture,
        RoomPictureRequestSchema,
        { room: roomId.value, ...what, format: ImageFormat.IMAGE_PNG, width: 480, height: 360 },
        ImageAnswerSchema,
      )
      .then(({ payload }) => dataUrl(payload));
    pictures.set(key, made);
    made.catch(() => pictures.delete(key));
  }
  return made;
}

/** A link for somebody without a token, who may review or only look. */
export async function invite(name: string, may: RoomRole, days: number): Promise<string> {
  const expiresS = BigInt(Math.floor(Date.now() / 1000) + days * 86400);
  const answer = await act({ invite: { name, role: may, expiresS } });
  if (!answer?.secret) return "";
  const url = new URL(location.pathname, location.href);
  url.searchParams.set("room", roomId.value);
  url.hash = `token=${answer.secret}`;
  return url.href;
}

// ---- following

effect(() => {
  const { is } = connection.value;
  if (is === "ready") {
    if (roomId.peek() && (lost || !subscription)) sit();
    lost = false;
    void pump();
    if (!roomId.peek()) void listRooms();
  } else if (is === "offline") lost = true;
});
effect(() => {
  void scene.value;
  void info.value;
  void status.value.mode;
  if (cameraWaits && viewer?.framed) {
    const before = shared;
    shared = null;
    showCamera();
    shared = before ? sceneNow() : null;
  }
  share();
});
let told = 0;
effect(() => {
  void scene.value.orbit;
  if (!state.value || performance.now() - told < 60) return;
  told = performance.now();
  tell({});
});
addEventListener("beforeunload", markRead);
