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
  number: bigint;
  sent: boolean;
  done: (answer: RoomEditAnswer) => void;
  failed: (error: unknown) => void;
}
const edits: Edit[] = [];
/** Newest event by this page that was acknowledged, and its room. */
export const answered = { room: "", sequence: 0n };
let lastNumber = 0n;
let pumping = false;

/** Resolves when the event is on the daemon's disk; rejects where it was refused. */
export function edit(action: ActionInit): Promise<RoomEditAnswer> {
  return new Promise((done, failed) => {
    const room = roomId.value;
    edits.push({ room, action, number: ++lastNumber, sent: false, done, failed });
    waiting.value = edits.length;
    void pump();
  });
}

/** Sends what waits; also for rooms that were left meanwhile. */
export async function pump(): Promise<void> {
  if (pumping) return;
  pumping = true;
  while (edits[0] && client.hello) {
    const first = edits[0];
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
      first.done(message);
    } catch (error) {
      if (error instanceof DisconnectedError) break; // the same number is done once
      const wait = busyMs(error);
      if (wait !== null) {
        first.sent = false;
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

/** A change of the scene that has not been sent yet: a newer one may take its place. */
export function unsentChange(): Edit | null {
  const last = edits.at(-1);
  return last && !last.sent && last.room === roomId.value && last.action.scene ? last : null;
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
