// SPDX-License-Identifier: MIT
// The list of pins: which pins are marked as new, and the keys that open the next one.
import { create } from "@bufbuild/protobuf";
import { beforeEach, expect, test } from "vitest";
import "./fake-browser";
import { ParticipantSchema, PinSchema, RoomStateSchema } from "../src/gen/relight_pb";

const here = await import("../src/room/here");
const review = await import("../src/ui/review-state");

const pin = (sequence: bigint, by: string, name: string) => {
  const stamp = { sequence, by, name };
  return create(PinSchema, { stamp, notes: [{ stamp, text: "too dark" }] });
};

beforeEach(() => {
  here.me.value = 7n;
  here.people.value = new Map([[7n, create(ParticipantSchema, { key: 7n, by: "guest:1" })]]);
  here.readBefore.value = 4;
});

test("notes of another person are new, also where nobody has a name", () => {
  expect(here.isNew(pin(5n, "guest:2", ""))).toBe(true);
  expect(here.isNew(pin(5n, "guest:1", "Bob"))).toBe(true);
  expect(here.isNew(pin(5n, "guest:1", ""))).toBe(false);
  expect(here.isNew(pin(4n, "guest:2", ""))).toBe(false);
});

test("from no pin the next one is the first, and the one before it the last", () => {
  const pins = [5n, 6n, 7n].map((number) => pin(number, "guest:2", ""));
  here.state.value = create(RoomStateSchema, { room: "r1", pins });
  review.jumpToPin(1);
  expect(review.openPin.value).toBe(5n);
  review.jumpToPin(-1);
  expect(review.openPin.value).toBe(7n);
  review.openPin.value = null;
  review.jumpToPin(-1);
  expect(review.openPin.value).toBe(7n);
});
