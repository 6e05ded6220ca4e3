// SPDX-License-Identifier: MIT
// What the review shows and which tool is in the hand; words about its items.
import { computed, signal } from "@preact/signals";
import type { Pin, RoomState, Stamp } from "../gen/relight_pb";
import { sameJson } from "../room/convert";
import { myName, state } from "../room/here";
import type { Kept } from "../room/pictures";
import type { Point } from "../room/pick";

/** What the next press on the model does. */
export const tool = signal<"none" | "pin" | "draw">("none");
/** Where the pin goes whose text is being written. */
export const newPin = signal<Point | null>(null);
/** Sequence of the pin whose thread is open. */
export const openPin = signal<bigint | null>(null);
export const printing = signal(false);
/** The tab of the settings that is shown. */
export const tab = signal<"light" | "material" | "view" | "review">("light");
/** Shows the thread of a pin, whichever tab was shown before. */
export function openThread(number: bigint): void {
  openPin.value = number;
  tab.value = "review";
}
/** Asks what is said about this point. */
export function askAbout(point: Point): void {
  newPin.value = point;
  tab.value = "review";
}
/** Two scenes of the room that are compared. */
export const comparing = signal<{ a: Kept; b: Kept } | null>(null);

/** Whether a comparison or the review on paper covers the page: its keys and buttons rest then. */
export const covered = computed(() => printing.value || comparing.value !== null);

/** Points of the stroke that is being drawn. */
export const drawn = signal<Point[]>([]);

/** The room was left. */
export function forgetReview(): void {
  drawn.value = [];
  tool.value = "none";
  newPin.value = openPin.value = comparing.value = null;
  printing.value = false;
}

export type Filter = "open" | "resolved" | "mine" | "all";
export const filter = signal<Filter>("open");

export const numberOf = (item: { stamp?: Stamp }) => item.stamp?.sequence ?? 0n;
export const byOf = (stamp: Stamp | undefined) => stamp?.name || stamp?.by || "";
export const timeOf = (stamp: Stamp | undefined) =>
  new Date(Number((stamp?.timeUs ?? 0n) / 1000n)).toLocaleString([], {
    dateStyle: "medium",
    timeStyle: "short",
  });

function isMine(pin: Pin): boolean {
  const name = myName.value.toLowerCase();
  return (
    name !== "" &&
    pin.notes.some(
      (note) =>
        note.stamp?.name.toLowerCase() === name ||
        note.mentions.some((word) => name.startsWith(word.toLowerCase())),
    )
  );
}
export const shownPins = computed(() =>
  (state.value?.pins ?? []).filter((pin) => {
    if (filter.value === "all") return true;
    if (filter.value === "mine") return isMine(pin);
    return pin.resolved === (filter.value === "resolved");
  }),
);

/** Pins are counted in the order in which they were placed. */
export const pinLabel = (number: bigint) =>
  1 + (state.value?.pins ?? []).findIndex((pin) => numberOf(pin) === number);

export function jumpToPin(by: number): void {
  const all = shownPins.value;
  if (!all.length) return;
  const open = all.findIndex((pin) => numberOf(pin) === openPin.value);
  const at = open < 0 && by < 0 ? 0 : open;
  const next = all[(at + by + all.length) % all.length] ?? all[0];
  if (next) openThread(numberOf(next));
}

/** Number of the revision that the scene is now; 0: it is none. */
export function revisionNow(now: RoomState): number {
  return (
    [...now.revisions].reverse().find((one) => sameJson(one.scene, now.scene))?.number ?? 0
  );
}
