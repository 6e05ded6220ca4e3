// SPDX-License-Identifier: MIT
// What others see of this person: a cursor on the surface, whom it follows, its camera, the parts of
// the scene that its hand moves now, and its own scene while it looks around alone. The newest
// counts; nothing of it is stored.
import { create, toBinary } from "@bufbuild/protobuf";
import { RoomPresenceRequestSchema, SceneSchema } from "../gen/relight_pb";
import { Type } from "../protocol/frame";
import { client, scene, viewer } from "../ui/store";
import type { PartName, SceneInit } from "./convert";
import { alone, colorOf, follows, leads, me, myName, seat, state } from "./here";
import type { Point } from "./pick";

const PAUSE_MS = 25; // between two messages
const MOST_OWN = 12 << 10; // bytes of a scene of one's own: a participant has 16 KiB

export interface Hand {
  scene: SceneInit;
  parts: PartName[];
}
let cursor: Point | null = null;
let hand: Hand | null = null;
let own: SceneInit | null = null;
let sent = 0;
let timer: ReturnType<typeof setTimeout> | undefined;

const vec = (v: readonly [number, number, number]) => ({ x: v[0], y: v[1], z: v[2] });

function send(): void {
  timer = undefined;
  sent = performance.now();
  if (!seat.id || !state.value || !client.hello) return;
  const placed = viewer?.framed ? viewer.placed(scene.value) : null;
  client.notify(Type.RoomPresence, RoomPresenceRequestSchema, {
    subscription: seat.id,
    me: {
      name: myName.value,
      color: colorOf(me.value),
      alone: alone.value,
      follows: follows.value,
      leads: leads.value,
      camera: placed
        ? {
            eye: vec(placed.eye),
            target: vec(placed.target),
            up: vec(placed.up),
            fovyDeg: placed.fovyDeg,
          }
        : undefined,
      cursor: cursor ? { ...cursor, position: vec(cursor.position) } : undefined,
      hand: hand?.scene,
      handParts: hand?.parts ?? [],
      own: alone.value && own ? own : undefined,
    },
  });
}

const fits = (scene: SceneInit) =>
  toBinary(SceneSchema, create(SceneSchema, scene)).length <= MOST_OWN;

interface News {
  cursor?: Point | null;
  hand?: Hand | null;
  /** What this person sees alone; one that is too large is not told. */
  own?: SceneInit | null;
}
/** Tells what changed, at once or with what changes within the next moment. */
export function tell(what: News = {}): void {
  if (what.cursor !== undefined) cursor = what.cursor;
  if (what.hand !== undefined) hand = what.hand;
  if (what.own !== undefined) own = what.own && fits(what.own) ? what.own : null;
  if (timer !== undefined) return;
  const wait = sent + PAUSE_MS - performance.now();
  if (wait <= 0) send();
  else timer = setTimeout(send, wait);
}
/** The room was left: nothing of it is told in the next one. */
export function forgetTold(): void {
  clearTimeout(timer);
  timer = undefined;
  cursor = hand = own = null;
}
export const handIsTold = () => hand !== null;
