// SPDX-License-Identifier: MIT
// Edits of rooms: one at a time, sent again after a lost connection until each has an answer.
import { create, type MessageInitShape } from "@bufbuild/protobuf";
import {
  RoomActionSchema,
  RoomEditAnswerSchema,
  RoomEditRequestSchema,
  type RoomEditAnswer,
} from "../gen/relight_pb";
import { busyMs } from "../protocol/busy";
import { DisconnectedError } from "../protocol/errors";
import { Type } from "../protocol/frame";
import { client, fault } from "../ui/store";
import { myName, roomId, waiting } from "./here";

export type ActionInit = MessageInitShape<typeof RoomActionSchema>;

/** `client` of this page's events. */
export const AUTHOR = Array.from(crypto.getRandomValues(new Uint8Array(8)), (b) =>
  b.toString(16).padStart(2, "0"),
).join("");

interface Edit {
  room: string;
  action: ActionInit;
  number: bigint; // 0: it was never sent
  sent: boolean;
  lost: boolean; // it was sent and has no answer: it may be done
  done: (answer: RoomEditAnswer) => void;
  failed: (error: unknown) => void;
}
const edits: Edit[] = [];
/** Newest event by this page that was acknowledged, and its room. */
export const answered = { room: "", sequence: 0n };
/** Newest event of this page that changed a part of a room's scene, by both. */
const ownChanges = new Map<string, bigint>();
let lastNumber = 0n;
let pumping = false;

/** Resolves when the event is on the daemon's disk; rejects where it was refused. */
export function edit(action: ActionInit): Promise<RoomEditAnswer> {
  return new Promise((done, failed) => {
    const room = roomId.value;
    edits.push({ room, action, number: 0n, sent: false, lost: false, done, failed });
    waiting.value = edits.length;
    void pump();
  });
}

// A change names the last event that it has seen; only later changes by others are a conflict. Where
// this page's own changes make that event differ between the parts, they are sent as several changes.
function divide(first: Edit): void {
  const { scene } = first.action;
  if (!scene?.since) return;
  const { since, parts = [] } = scene;
  const seen = (part: string) => {
    const own = ownChanges.get(`${first.room} ${part}`) ?? 0n;
    return own > since ? own : since;
  };
  const [least = since] = parts.map(seen).sort((a, b) => (a < b ? -1 : 1));
  const later = parts.filter((part) => seen(part) > least);
  const now = parts.filter((part) => seen(part) === least);
  first.action = { scene: { ...scene, parts: now, since: least } };
  if (!later.length) return;
  const rest = { ...first, number: 0n, action: { scene: { ...scene, parts: later } } };
  edits.splice(1, 0, rest);
  first.done = () => undefined; // the last of them says so
  waiting.value = edits.length;
}

/** Sends what waits; also for rooms that were left meanwhile. */
export async function pump(): Promise<void> {
  if (pumping) return;
  pumping = true;
  while (edits[0] && client.hello) {
    const first = edits[0];
    if (!first.lost) divide(first);
    first.number ||= ++lastNumber;
    first.sent = true; // again after a refusal: what took its place meanwhile goes with it
    try {
      const { message } = await client.request(
        Type.RoomEdit,
        RoomEditRequestSchema,
        {
          room: first.room,
          action: create(RoomActionSchema, first.action),
          name: myName.value,
          client: AUTHOR,
          number: first.number,
        },
        RoomEditAnswerSchema,
      );
      Object.assign(answered, { room: first.room, sequence: message.sequence });
      for (const part of first.action.scene?.parts ?? [])
        ownChanges.set(`${first.room} ${part}`, message.sequence);
      first.done(message);
    } catch (error) {
      if (error instanceof DisconnectedError) {
        first.lost = true;
        break; // the same number is done once
      }
      const wait = busyMs(error);
      if (wait !== null) {
        first.sent = first.lost;
        await new Promise((done) => setTimeout(done, wait));
        continue;
      }
      first.failed(error);
    }
    edits.shift();
    waiting.value = edits.length;
  }
  pumping = false;
}

/** A change of the scene that has not been sent yet: a newer one may take its place, but not where
 * that one saw more. */
export function unsentChange(): Edit | null {
  const last = edits.at(-1);
  const waits = last && !last.sent && last.room === roomId.value && last.action.scene;
  return waits && !(client.hello && waits.since) ? last : null;
}
/** Whether an edit of the scene of this room has no answer yet. */
export const scenePends = () =>
  edits.some((one) => one.room === roomId.value && one.action.scene !== undefined);

/** Does something in the room; a refusal is said. */
export async function act(action: ActionInit): Promise<RoomEditAnswer | null> {
  try {
    return await edit(action);
  } catch (error) {
    fault(error);
    return null;
  }
}

// A page that is closed while edits wait would lose them: the browser asks first. One that was sent
// and awaits its answer is the daemon's.
addEventListener("beforeunload", (event) => {
  if (edits.some(({ sent }) => !sent) || (edits.length && !client.hello))
    event.preventDefault();
});
