// SPDX-License-Identifier: MIT
// From one room to another: nothing of the first one is in the second.
import { create, toBinary, type MessageInitShape } from "@bufbuild/protobuf";
import { beforeEach, expect, test } from "vitest";
import { fakeDaemon, tellState, turn } from "./fake-browser";
import {
  EventKind,
  EventSchema,
  PinSchema,
  type RoomActionSchema,
  RoomEventsSchema,
  RoomRole,
  RoomStateSchema,
  SeenSchema,
} from "../src/gen/relight_pb";
import { Type } from "../src/protocol/frame";
import type { Mesh } from "../src/scene/geometry";
import type { Viewer } from "../src/scene/viewer";

const store = await import("../src/ui/store");
const here = await import("../src/room/here");
const session = await import("../src/room/session");
const review = await import("../src/ui/review-state");
const { invite } = await import("../src/ui/invite");
const { anchors } = await import("../src/room/anchored");
const { handIsTold, tell } = await import("../src/room/presence");
const daemon = fakeDaemon(store.client);

const TRIANGLE = {
  nVertex: 3,
  positions: Float32Array.from([0, 0, 0, 1, 0, 0, 0, 1, 0]),
  normals: new Float32Array(9),
  triangles: Uint32Array.from([0, 1, 2]),
  hash: "m",
} as unknown as Mesh;
const MODEL = "a".repeat(32);
const light = (rotateDeg: number) => [
  { env: "constant", rotateDeg, gain: { x: 1, y: 1, z: 1 } },
];
const pin = (x: number) =>
  create(PinSchema, {
    stamp: { sequence: 5n },
    at: { triangle: 0, b1: x, b2: 0, position: { x, y: 0, z: 0 } },
    seen: create(SeenSchema, { model: MODEL, meshHash: "m" }),
  });
const sitIn = (room: string, rotate: number, x = 0.5) => {
  session.enter(room);
  tellState(daemon, {
    room,
    sequence: 9n,
    scene: { model: MODEL, lights: light(rotate) },
    pins: [pin(x)],
  });
};

beforeEach(async () => {
  daemon.answer = () => ({});
  if (here.roomId.value) session.leave();
  await turn();
  daemon.asked = [];
  daemon.told = [];
});

test("pins of one number lie where each room has them", () => {
  store.useViewer({
    shape: TRIANGLE,
    framed: null,
    show: () => undefined,
  } as unknown as Viewer);
  store.status.value = { ...store.status.value, mode: "mesh" };
  sitIn("r1", 0, 0.25);
  expect(anchors.value.get(5n)?.position[0]).toBeCloseTo(0.25, 6);
  sitIn("r2", 0, 0.75);
  expect(anchors.value.get(5n)?.position[0]).toBeCloseTo(0.75, 6);
});

test("threads, tools and comparisons of a room end with it", () => {
  const open = () => {
    review.openPin.value = 5n;
    review.newPin.value = { triangle: 0, object: 0, b1: 0, b2: 0, position: [0, 0, 0] };
    review.comparing.value = { a: { revision: 1 }, b: {} };
    review.tool.value = "draw";
    review.printing.value = true;
    review.drawn.value = [{ triangle: 0, object: 0, b1: 0, b2: 0, position: [0, 0, 0] }];
    here.conflict.value = "Theirs is shown.";
  };
  const shown = () => [
    review.openPin.value,
    review.newPin.value,
    review.comparing.value,
    review.tool.value,
    review.printing.value,
    review.drawn.value.length,
    here.conflict.value,
  ];
  sitIn("r1", 0);
  open();
  sitIn("r2", 0);
  expect(shown()).toEqual([null, null, null, "none", false, 0, ""]);
  open();
  session.leave();
  expect(shown()).toEqual([null, null, null, "none", false, 0, ""]);
  expect(here.mayReview.value).toBe(false);
});

test("a room that is left for another one was read", () => {
  sitIn("r5", 0);
  sitIn("r6", 0);
  const read = JSON.parse(localStorage.getItem("relight-room-seen") ?? "{}") as object;
  expect(read).toMatchObject({ r5: 9 });
});

test("a hand of one room is not told in the next", () => {
  sitIn("r1", 0);
  tell({ hand: { scene: { model: MODEL }, parts: ["model"] } });
  sitIn("r2", 0);
  expect(handIsTold()).toBe(false);
});

test("an invitation is to the room that it was made in", async () => {
  let answer: (message: unknown) => void = () => undefined;
  daemon.answer = (type) =>
    type === Type.RoomEdit ? new Promise((done) => (answer = done)) : {};
  sitIn("r1", 0);
  const link = invite("Cy", RoomRole.ROLE_VIEWER, 1);
  await turn();
  sitIn("r2", 0);
  answer({ secret: "relight_guest_1" });
  expect(await link).toMatch(/room=r1#token=relight_guest_1$/);
});

test("a change of one room that has no answer does not hide the scene of the next", async () => {
  daemon.answer = (type) => (type === Type.RoomEdit ? new Promise(() => undefined) : {});
  sitIn("r1", 10);
  store.set({ lamps: [{ env: "constant", rotate: 20, tilt: 0, gain: [1, 1, 1] }] });
  sitIn("r2", 70);
  await turn();
  expect(daemon.asked.filter(({ type }) => type === Type.RoomEdit).length).toBe(1);
  expect(store.scene.value.lamps[0]?.rotate).toBe(70);
});

test("a light that the daemon refused is not sent at every change", async () => {
  const turned = (rotate: number) => [
    { env: "page:rim", rotate, tilt: 0, gain: [1, 1, 1] as [number, number, number] },
  ];
  const sent = () => daemon.asked.filter(({ type }) => type === Type.PutBlob).length;
  daemon.answer = (type) => {
    if (type === Type.PutBlob) throw new Error("the disk is full");
    return {};
  };
  sitIn("r7", 0);
  store.set({ lamps: turned(10) });
  await turn();
  const first = sent();
  expect(first).toBeGreaterThan(0);
  store.notice.value = null;
  store.set({ lamps: turned(20) });
  await turn();
  expect(sent()).toBe(first);
  expect(store.notice.value).toBeNull();
});

test("a state that is older than the events is asked for again", async () => {
  const told = (sequence: bigint, action: MessageInitShape<typeof RoomActionSchema>) =>
    daemon.streams.at(-1)?.answered({
      message: create(EventSchema, { kind: EventKind.EVENT_ROOM_EVENTS }),
      payload: toBinary(
        RoomEventsSchema,
        create(RoomEventsSchema, { events: [{ stamp: { sequence }, action }] }),
      ),
    });
  const state = (sequence: bigint, resolved: boolean) => {
    const pins = [{ stamp: { sequence: 5n }, resolved }];
    const init = { room: "r8", sequence, scene: { model: MODEL, lights: light(0) }, pins };
    return toBinary(RoomStateSchema, create(RoomStateSchema, init));
  };
  sitIn("r8", 0);
  let answer: (message: unknown) => void = () => undefined;
  daemon.answer = (type) =>
    type === Type.RoomGet ? new Promise((done) => (answer = done)) : {};
  told(10n, { status: { pin: 5n, resolved: true } });
  await turn();
  // Somebody turns the light before the answer, which was made before that.
  told(11n, { scene: { scene: { lights: light(30) }, parts: ["lights"] } });
  daemon.payload = state(10n, true);
  daemon.answer = () => ({ sequence: 11n, role: RoomRole.ROLE_OWNER });
  answer({ sequence: 10n, role: RoomRole.ROLE_OWNER });
  await Promise.resolve();
  daemon.payload = state(11n, true);
  await turn();
  expect(here.state.value?.pins[0]?.resolved).toBe(true);
  daemon.payload = new Uint8Array(0);
});
