// SPDX-License-Identifier: MIT
// What others see of this person: a cursor on the surface, whom it follows, its camera, and the
// parts of the scene that its hand moves now. The newest counts; nothing of it is stored.
import { RoomPresenceRequestSchema } from "../gen/relight_pb";
import { Type } from "../protocol/frame";
import { client, scene, viewer } from "../ui/store";
import type { PartName, SceneInit } from "./convert";
import { alone, colorOf, follows, leads, me, myName, seat, state } from "./here";
import type { Point } from "./pick";

const PAUSE_MS = 25; // between two messages

export interface Hand {
  scene: SceneInit;
  parts: PartName[];
}
let cursor: Point | null = null;
let hand: Hand | null = null;
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
    },
  });
}

/** Tells what changed, at once or with what changes within the next moment. */
export function tell(what: { cursor?: Point | null; hand?: Hand | null } = {}): void {
  if (what.cursor !== undefined) cursor = what.cursor;
  if (what.hand !== undefined) hand = what.hand;
  if (timer !== undefined) return;
  const wait = sent + PAUSE_MS - performance.now();
  if (wait <= 0) send();
  else timer = setTimeout(send, wait);
}
export const handIsTold = () => hand !== null;
