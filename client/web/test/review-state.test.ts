// SPDX-License-Identifier: MIT
// The list of pins: what is new in it.
import { create } from "@bufbuild/protobuf";
import { beforeEach, expect, test } from "vitest";
import "./fake-browser";
import { ParticipantSchema, PinSchema } from "../src/gen/relight_pb";

const here = await import("../src/room/here");

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
