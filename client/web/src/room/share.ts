// SPDX-License-Identifier: MIT
// The page's scene and the room's follow each other. While a hand moves something the others see
// it by presence; when it rests one edit keeps it.
import { effect, untracked } from "@preact/signals";
import { Engine, ErrorCode, type Participant, type Scene, type Shade } from "../gen/relight_pb";
import { whenFree } from "../protocol/busy";
import { DisconnectedError, RelightError } from "../protocol/errors";
import { upload } from "../protocol/upload";
import { beginHistory, change, client, fault, info, scene, status, viewer } from "../ui/store";
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
import { edit, scenePends, unsentChange } from "./edits";
import { alone, apart, conflict, follows, mayReview, me, state, watched } from "./here";
import { builtinFile } from "./hdr";
import { handIsTold, tell } from "./presence";

/** Of pictures that are kept: pins, decisions. */
export const PICTURE = { width: 960, height: 720 };
const REST_MS = 250; // a hand that moved nothing for so long rests
const MOST_MS = 10_000; // one that does not rest is kept so often

let shared: SceneInit | null = null; // as all see it; null: nothing is sent
const uploads = new Map<string, string>(); // "page:ID" to "env:HASH"
const sending = new Set<string>();
const refused = new Set<string>(); // lights that the daemon did not take
const held = new Set<PartName>(); // what this hand moved since its last edit
const hands = new Map<PartName, { key: bigint; scene: Scene }>(); // what others move now
let heldSince = 0;
let rest: ReturnType<typeof setTimeout> | undefined;
let missed = false; // a state of the room that was not shown
let again: () => void = () => undefined;
let newest: () => bigint = () => 0n;

/** fetch: reads the state anew; sequence: of the newest event that came. */
export function useRoom(fetch: () => void, sequence: () => bigint): void {
  again = fetch;
  newest = sequence;
}

// ---- the scene as the room has it

function bringLights(): void {
  for (const { env } of scene.value.lamps) {
    if (!env.startsWith("page:") || uploads.has(env)) continue;
    if (sending.has(env) || refused.has(env)) continue;
    const bytes = builtinFile(env);
    if (!bytes || !client.can("upload")) continue;
    sending.add(env);
    whenFree(() => upload(client, `${env.slice(5)}.hdr`, bytes))
      .then((hash) => {
        uploads.set(env, `env:${hash}`);
        share();
      })
      .catch((error: unknown) => {
        if (!(error instanceof DisconnectedError)) refused.add(env);
        fault(error);
      })
      .finally(() => sending.delete(env));
  }
}

const isId = (model: string) => /^[0-9a-f]{32}$/.test(model);

export function sceneNow(): SceneInit {
  const now = scene.value;
  const lights = lightsOf(now.lamps, uploads) ?? shared?.lights ?? [];
  // A name is known as an id when the model is here.
  const model = isId(now.model)
    ? now.model
    : (info.value?.model ?? state.value?.scene?.model ?? "");
  const placed = viewer?.framed ? viewer.placed(now) : null;
  const out = sceneOf(now, model, placed, lights, PICTURE, state.value?.scene);
  if (!placed) out.camera = shared?.camera;
  return out;
}

/** What this person sees, for a pin: where the daemon draws a model without a bake, by the engine that
 * draws it now. */
export function sceneSeen(): SceneInit {
  const now = sceneNow();
  const { mode, engine } = status.value;
  const drawn = Engine[engine.toUpperCase() as keyof typeof Engine] as Engine | undefined;
  if (mode !== "pictures" || !drawn || now.shade?.engine) return now;
  return { ...now, shade: { ...(now.shade as Shade), engine: drawn } };
}

/** Of a new room: lights of the page are uploaded first. */
export async function shownScene(): Promise<SceneInit> {
  for (const { env } of scene.value.lamps) {
    const bytes = uploads.has(env) ? null : builtinFile(env);
    if (bytes) uploads.set(env, `env:${await upload(client, `${env.slice(5)}.hdr`, bytes)}`);
  }
  return sceneNow();
}

// ---- out: by presence while the hand moves, as an edit when it rests

let own: SceneInit | null = null; // as those who follow this person see it
// While this person looks around alone its scene goes out by presence alone.
function shareOwn(): void {
  shared = null; // back to all, nothing of it is the room's
  bringLights();
  const now = sceneNow();
  if (sameJson(now, own)) return;
  own = now;
  tell({ own });
}

function share(): void {
  if (!state.value) return;
  if (alone.value) {
    shareOwn();
    return;
  }
  own = null;
  if (apart.value || !mayReview.value || !shared) return;
  bringLights();
  const now = sceneNow();
  const before = shared;
  const parts = PARTS.filter(
    (part) => !sameJson(now[part], before[part]) && !(part === "camera" && follows.value),
  );
  if (!parts.length) return;
  shared = now;
  if (!held.size) heldSince = performance.now();
  for (const part of parts) held.add(part);
  tellHand(now);
  clearTimeout(rest);
  const left = heldSince + MOST_MS - performance.now();
  rest = setTimeout(putDown, Math.max(0, Math.min(REST_MS, left)));
}

function tellHand(now: SceneInit): void {
  const parts = [...held];
  const moved = Object.fromEntries(parts.map((part) => [part, now[part]])) as SceneInit;
  tell({ hand: { scene: moved, parts } });
}

/** What the hand moved becomes an edit. */
export function putDown(): void {
  clearTimeout(rest);
  if (!held.size) return;
  const parts = [...held];
  held.clear();
  if (state.value && !apart.value) sendParts(parts, sceneNow());
}

/** Sends parts of the scene; a change that waits is replaced by the newer one. */
function sendParts(parts: readonly PartName[], next: SceneInit): void {
  const last = unsentChange();
  const before = last?.action.scene;
  const all = [...new Set([...parts, ...((before?.parts ?? []) as PartName[])])];
  const values = Object.fromEntries(
    all.map((part) => [part, parts.includes(part) ? next[part] : before?.scene?.[part]]),
  );
  const action = {
    scene: {
      scene: values as SceneInit,
      parts: all,
      // Offline, another one's change must not be overwritten unseen.
      since: client.hello ? 0n : before?.since || newest(),
    },
  };
  if (last) {
    last.action = action;
    return;
  }
  edit(action)
    .catch((error: unknown) => {
      if (error instanceof RelightError && error.code === ErrorCode.ERROR_MISMATCH)
        conflict.value =
          "While you were offline another person changed the same part of the scene. Theirs is " +
          "shown, yours was not kept.";
      else fault(error);
      again();
    })
    .finally(() => {
      if (!held.size && handIsTold()) tell({ hand: null });
      if (missed && !scenePends()) again();
    });
}

// ---- in: what others do

// The room's scene with what others move now, or the own scene of the one who is followed.
function roomScene(): Scene | null {
  if (watched.value?.own) return watched.value.own;
  const now = state.value?.scene;
  if (!now || !hands.size) return now ?? null;
  const moved = [...hands].map(([part, hand]) => [part, hand.scene[part]]);
  return { ...now, ...(Object.fromEntries(moved) as Partial<Scene>) };
}

// The camera of the room waits until the model is here.
let cameraWaits = false;
function showCamera(): void {
  const frame = viewer?.framed;
  const camera = roomScene()?.camera;
  cameraWaits = camera !== undefined && !frame;
  const orbit = frame && camera ? orbitOf(camera, frame) : null;
  if (orbit && (!follows.value || watched.value)) change({ orbit });
}

/** Shows parts of the room's scene, or of the one that is watched; not those that this person's hand
 * holds. */
export function showParts(parts: readonly string[]): void {
  const next = roomScene();
  const free = parts.filter((part) => !held.has(part as PartName));
  if (!next || alone.value || !free.length) return;
  shared = null; // nothing is sent meanwhile
  change(withParts(scene.value, next, free, uploads));
  if (free.includes("camera")) showCamera();
  shared = apart.value ? null : sceneNow();
}

// A model that this person chose by its name becomes the room's when its id is known.
function choicePends(): boolean {
  const { model } = scene.value;
  return shared !== null && !isId(model) && info.value?.name !== model;
}

/** Shows the room's state; while what this person did is on its way, once it has arrived. */
export function showRoom(): void {
  missed = scenePends();
  if (missed) return;
  showParts(choicePends() ? PARTS.filter((part) => part !== "model") : PARTS);
}

// From the room's scene to the own one of who is followed, along with it, and back.
let watching: Scene | null = null;
effect(() => {
  const next = watched.value?.own ?? null;
  const before = watching;
  watching = next;
  if (next === before) return;
  const same = (part: PartName) => next && before && sameJson(next[part], before[part]);
  untracked(() => {
    if (next && shared && held.size) sendParts([...held], shared); // what the hand held is of the room
    held.clear();
    showParts(PARTS.filter((part) => !same(part)));
  });
});

/** Somebody's hand takes parts of the scene, moves them, or puts them down. */
export function takeHand(person: Participant): void {
  if (person.key === me.value) return;
  const parts = person.gone ? [] : (person.handParts as PartName[]);
  const moved: PartName[] = [];
  for (const [part, hand] of hands)
    if (hand.key === person.key && !parts.includes(part)) {
      hands.delete(part);
      moved.push(part);
    }
  for (const part of parts) {
    const before = hands.get(part);
    if (!person.hand || !PARTS.includes(part)) continue;
    hands.set(part, { key: person.key, scene: person.hand });
    if (!sameJson(before?.scene[part], person.hand[part])) moved.push(part);
  }
  if (moved.length) showParts(moved);
}
export const handsOf = () => new Set([...hands.values()].map((hand) => hand.key));

/** A scene of the room's history, for this person alone. */
export function showAlone(past: Scene): void {
  shared = null;
  change(withParts(scene.value, past, PARTS, uploads));
  const frame = viewer?.framed;
  const orbit = frame ? orbitOf(past.camera, frame) : null;
  if (orbit) change({ orbit });
  beginHistory();
}

/** Makes a scene of the room's history the room's scene again, number by number. */
export function bringBack(past: Scene): void {
  putDown();
  showAlone(past);
  shared = sceneNow();
  sendParts(PARTS, past);
}

/** Whether nothing of this page is on its way to the room. */
const rests = () => !held.size && !scenePends() && !handIsTold();
Object.assign(globalThis, { relightRoom: { rests } }); // for tests and for the console

/** The room was left. */
export function forgetRoom(): void {
  putDown();
  held.clear();
  hands.clear();
  shared = own = null;
  cameraWaits = missed = false;
  refused.clear();
}

// Not at every change of `state`: what others changed is shown by showParts, and until then it
// would be taken for this person's hand.
effect(() => {
  void scene.value;
  void info.value;
  void status.value.mode;
  void alone.value;
  void apart.value;
  void mayReview.value;
  void follows.value;
  untracked(shareScene);
});

function shareScene(): void {
  if (cameraWaits && viewer?.framed) {
    const before = shared;
    shared = null;
    showCamera();
    shared = before ? sceneNow() : null;
  }
  share();
}
