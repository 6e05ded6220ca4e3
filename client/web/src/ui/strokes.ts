// SPDX-License-Identifier: MIT
// Strokes of this page from the last point until the daemon has them. One that was refused stays, so
// that it can be sent again.
import { signal } from "@preact/signals";
import { act } from "../room/edits";
import { colorOf, me, roomId } from "../room/here";
import type { Point } from "../room/pick";

export const WIDTH_PX = 4;

export interface OwnStroke {
  room: string;
  pin: bigint;
  points: readonly Point[];
  refused: boolean;
}
const all = signal<readonly OwnStroke[]>([]);

/** Those of this room. */
export const ownStrokes = () => all.value.filter(({ room }) => room === roomId.value);
export const refusedStrokes = (pin: bigint) =>
  ownStrokes().filter((one) => one.refused && one.pin === pin);

export function dropStroke(stroke: OwnStroke): void {
  all.value = all.value.filter((one) => one !== stroke);
}

/** Sends a stroke of two or more points, also one that was refused. */
export async function sendStroke(points: readonly Point[], pin: bigint): Promise<void> {
  const stroke = { room: roomId.value, pin, points, refused: false };
  all.value = [...all.value, stroke];
  const line = points.map(({ position: [x, y, z], ...at }) => ({
    ...at,
    position: { x, y, z },
  }));
  const answer = await act({
    stroke: { points: line, color: colorOf(me.value), width: WIDTH_PX, pin },
  });
  all.value = all.value.flatMap((one) =>
    one !== stroke ? [one] : answer ? [] : [{ ...one, refused: true }],
  );
}

export function sendAgain(stroke: OwnStroke): void {
  dropStroke(stroke);
  void sendStroke(stroke.points, stroke.pin);
}
