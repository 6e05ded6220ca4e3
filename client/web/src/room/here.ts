// SPDX-License-Identifier: MIT
// What the page knows of rooms: the list of them, the one that it is in, who is there.
import { computed, signal } from "@preact/signals";
import {
  RoomRole,
  type Participant,
  type Pin,
  type RoomState,
  type RoomSummary,
  type Stamp,
} from "../gen/relight_pb";
import { keep, kept } from "../state/kept";

const NAME_KEY = "relight-name";
const SEEN_KEY = "relight-room-seen";
const COLORS = [0xe0714f, 0x4f9be0, 0x59b36a, 0xc77bd6, 0xd9a92f, 0x3fb5ae];

export const rooms = signal<RoomSummary[] | null>(null);
/** Whether there are rooms of older changes that the list does not have. */
export const roomsMore = signal(false);
export const roomId = signal(new URLSearchParams(location.search).get("room") ?? "");
export const state = signal<RoomState | null>(null);
export const role = signal(RoomRole.ROLE_NONE);
export const people = signal<ReadonlyMap<bigint, Participant>>(new Map());
export const me = signal(0n);
export const alone = signal(false);
/** Key of the person whose camera is followed; 0: nobody's. */
export const follows = signal(0n);
/** Whether the others are asked to take this person's camera. */
export const leads = signal(false);
/** What was not kept of this person's work; empty: all was. */
export const conflict = signal("");
/** Edits that wait for the connection. */
export const waiting = signal(0);
/** Request id of the SUBSCRIBE; 0: the page sits in no room. */
export const seat = { id: 0n };

export const myName = signal(kept("localStorage", NAME_KEY) ?? "");
export const mayReview = computed(
  () => role.value >= RoomRole.ROLE_REVIEWER && !state.value?.closed,
);
/** The one whose own scene this person sees: who is followed, or whom that one follows, looks around
 * alone. */
export const watched = computed(() => {
  const passed = new Set([me.value]);
  let one = people.value.get(follows.value);
  while (one && !one.alone && one.follows && !passed.has(one.key)) {
    passed.add(one.key);
    one = people.value.get(one.follows);
  }
  return !alone.value && one?.alone && one.own && one.key !== me.value ? one : null;
});
/** Whether something else than the room's scene is shown. */
export const apart = computed(() => alone.value || watched.value !== null);
export const others = computed(() =>
  [...people.value.values()].filter((person) => person.key !== me.value),
);

export function setName(name: string): void {
  myName.value = name.slice(0, 60);
  keep("localStorage", NAME_KEY, myName.value);
}
export const colorOf = (key: bigint) => COLORS[Number(key % BigInt(COLORS.length))] ?? 0xffffff;
export const css = (color: number) => `#${color.toString(16).padStart(6, "0")}`;

// ---- what was read: the newest event seen of each room, in this browser

function seenBefore(): Record<string, number> {
  try {
    return JSON.parse(kept("localStorage", SEEN_KEY) ?? "{}") as Record<string, number>;
  } catch {
    return {};
  }
}
const seenStore = signal(seenBefore());
/** The sequence up to which a room was read before now. */
export const readBefore = signal(0);
export const unread = (room: RoomSummary) =>
  Number(room.sequence) > (seenStore.value[room.room] ?? 0);
/** What is new is measured from where the room was left the last time. */
export function beginReading(room: string): void {
  readBefore.value = seenStore.value[room] ?? 0;
}
export function leaveRead(): void {
  const now = state.value;
  if (!now) return;
  seenStore.value = { ...seenStore.value, [now.room]: Number(now.sequence) };
  keep("localStorage", SEEN_KEY, JSON.stringify(seenStore.value));
}
export function markRead(): void {
  leaveRead();
  readBefore.value = Number(state.value?.sequence ?? 0n);
}
// People without a name, and of one name, are told apart by their principals.
function isOwn({ by, name }: Stamp): boolean {
  const own = people.value.get(me.value)?.by ?? by;
  return name === myName.value && by === own;
}
/** Whether a pin has a note by another person that came since the room was read. */
export const isNew = (pin: Pin) =>
  pin.notes.some(
    ({ stamp }) => stamp && Number(stamp.sequence) > readBefore.value && !isOwn(stamp),
  );
