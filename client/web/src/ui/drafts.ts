// SPDX-License-Identifier: MIT
// Texts that are being written in a room. Each stays until the daemon has acknowledged it, also while
// its field is closed.
import { signal, type Signal } from "@preact/signals";
import type { RoomEditAnswer } from "../gen/relight_pb";
import { act, type ActionInit } from "../room/edits";
import { roomId } from "../room/here";

export interface Draft {
  text: Signal<string>;
  /** It is on its way: it is not sent a second time. */
  sending: Signal<boolean>;
}
const drafts = new Map<string, Draft>();

/** The text of a field of this room. */
export function draftOf(field: string): Draft {
  const key = `${roomId.value} ${field}`;
  let draft = drafts.get(key);
  if (!draft) drafts.set(key, (draft = { text: signal(""), sending: signal(false) }));
  return draft;
}

/** Sends the text; null where the daemon refused it, or where it is on its way already. What is
 * written meanwhile stays. */
export async function sendDraft(
  draft: Draft,
  actionOf: (text: string) => ActionInit,
): Promise<RoomEditAnswer | null> {
  const { text, sending } = draft;
  if (sending.value) return null;
  const sent = text.value;
  sending.value = true;
  const answer = await act(actionOf(sent.trim()));
  sending.value = false;
  if (answer && text.value === sent) text.value = "";
  return answer;
}
