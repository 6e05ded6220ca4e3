// SPDX-License-Identifier: MIT
// Back, undo and the address, outside of rooms and in them.
import { create } from "@bufbuild/protobuf";
import { beforeEach, expect, test } from "vitest";
import { browser, fakeDaemon, tellState, turn } from "./fake-browser";
import { ErrorCode, RoomRole, SceneSchema } from "../src/gen/relight_pb";
import { RelightError } from "../src/protocol/errors";
import { sceneOf } from "../src/room/convert";
import { Type } from "../src/protocol/frame";
import { FIRST } from "../src/state/scene-state";

const store = await import("../src/ui/store");
const here = await import("../src/room/here");
const session = await import("../src/room/session");
const { showAlone } = await import("../src/room/share");
const { swap } = await import("../src/ui/compare");
const daemon = fakeDaemon(store.client);

const rotateTo = (rotate: number) =>
  store.set({ lamps: [{ env: "constant", rotate, tilt: 0, gain: [1, 1, 1] }] });
const rotated = () => store.scene.value.lamps[0]?.rotate;
const roomIn = () => new URL(browser.entry.url).searchParams.get("room") ?? "";
const edits = () => daemon.asked.filter(({ type }) => type === Type.RoomEdit);
// The scene of a room, its light turned so far [deg].
const sceneAt = (rotate: number) =>
  sceneOf(
    FIRST,
    "a".repeat(32),
    null,
    [{ env: "constant", rotateDeg: rotate, gain: { x: 1, y: 1, z: 1 } }],
    { width: 4, height: 3 },
  );
const rests = () => new Promise((done) => setTimeout(done, 300));

function sitIn(room: string, rotate: number): void {
  session.enter(room);
  tellState(daemon, { room, sequence: 1n, scene: sceneAt(rotate) });
}

beforeEach(async () => {
  if (here.roomId.value) session.leave();
  await turn();
  daemon.asked = [];
});

test("Back outside of a room goes to the scene before", () => {
  rotateTo(10);
  rotateTo(20);
  browser.go(-1);
  expect(rotated()).toBe(10);
});

test("a link is of what is shown, where nothing has ended the turn either", () => {
  store.setOrbit({ ...store.scene.value.orbit, azimuth: 77 });
  expect(new URL(store.linkNow()).hash).toContain("orbit=77,");
});

test("Back in a room leaves it and writes no old scene into it", async () => {
  rotateTo(10);
  sitIn("r1", 40);
  expect(rotated()).toBe(40);
  rotateTo(50);
  rotateTo(60);
  await rests();
  const before = edits().length;
  browser.go(-1);
  await rests();
  expect(edits().length).toBe(before);
  expect(here.roomId.value).toBe("");
  expect(roomIn()).toBe("");
  expect(rotated()).toBe(10);
});

test("Forward enters the room again, without a new entry", async () => {
  rotateTo(10);
  sitIn("r2", 40);
  browser.go(-1);
  const entries = browser.entries.length;
  browser.go(1);
  expect(here.roomId.value).toBe("r2");
  tellState(daemon, { room: "r2", sequence: 1n, scene: sceneAt(45) });
  expect(rotated()).toBe(45);
  expect(browser.entries.length).toBe(entries);
  await rests();
  expect(edits()).toEqual([]);
});

test("Back from one room to another changes the seat", () => {
  sitIn("r3", 40);
  sitIn("r4", 50);
  browser.go(-1);
  expect(here.roomId.value).toBe("r3");
  expect(daemon.streams.at(-1)?.init["room"]).toBe("r3");
});

test("a link that a person opens in a room is the room's", async () => {
  sitIn("r5", 40);
  browser.type("#light=constant@70,0");
  expect(rotated()).toBe(70);
  await rests();
  expect(edits().length).toBe(1);
  browser.go(-1);
  await rests();
  expect(rotated()).toBe(70);
  expect(here.roomId.value).toBe("r5");
  expect(edits().length).toBe(1);
});

test("undo of a person who looks alone ends where it began to", () => {
  rotateTo(10);
  rotateTo(20);
  sitIn("r6", 40);
  session.lookAlone(true);
  expect(store.canUndo.value).toBe(false);
  rotateTo(50);
  store.undo();
  expect(rotated()).toBe(40);
  expect(store.canUndo.value).toBe(false);
});

test("undo of a person who looks at an old revision goes back to it", () => {
  sitIn("r8", 40);
  session.lookAlone(true);
  showAlone(create(SceneSchema, sceneAt(80)));
  rotateTo(90);
  store.undo();
  expect(rotated()).toBe(80);
});

test("undo after a room was left does not go back to before the room", () => {
  rotateTo(10);
  sitIn("r7", 40);
  session.leave();
  expect(store.canUndo.value).toBe(false);
  rotateTo(50);
  store.undo();
  expect(rotated()).toBe(40);
});

test("the model that the page chooses first is in the address, without a new entry", async () => {
  store.change({ model: "" });
  const entries = browser.entries.length;
  daemon.answer = () => ({
    models: [{ name: "bunny", model: "b" }],
    environments: [],
    files: [],
  });
  await store.refresh();
  expect(store.scene.value.model).toBe("bunny");
  expect(browser.entry.url).toContain("#model=bunny");
  expect(browser.entries.length).toBe(entries);
});

test("so is a file that the page loads first: Back does not go to a page without a model", async () => {
  store.change({ model: "" });
  const entries = browser.entries.length;
  daemon.answer = (type) =>
    type === Type.Load
      ? { model: "c".repeat(32) }
      : { models: [], environments: [], files: [{ path: "marble.prt" }] };
  await store.refresh();
  await turn();
  expect(store.scene.value.model).toBe("c".repeat(32));
  expect(browser.entry.url).toContain(`#model=${"c".repeat(32)}`);
  expect(browser.entries.length).toBe(entries);
  expect(store.canUndo.value).toBe(false);
});

test("a quantity in place of light goes with its state when A and B are swapped", () => {
  const other = { ...store.scene.value, exposure: 2, compare: null };
  store.set({ heat: "thickness", compare: { mode: "wipe", at: 0.5, other } });
  swap();
  expect(store.scene.value.heat).toBeUndefined();
  expect(store.scene.value.exposure).toBe(2);
  expect(store.scene.value.compare?.other.heat).toBe("thickness");
  swap();
  expect(store.scene.value.heat).toBe("thickness");
  expect(store.scene.value.compare?.other.heat).toBeUndefined();
});

test("in a room who may not change it has nothing to undo", () => {
  sitIn("r9", 40);
  expect(store.canUndo.value).toBe(true);
  here.role.value = RoomRole.ROLE_VIEWER;
  expect([store.canUndo.value, store.canRedo.value]).toEqual([false, false]);
  store.undo();
  expect(edits()).toEqual([]);
});

test("an undo without a change before it says so in the words of the page", async () => {
  sitIn("r10", 40);
  daemon.answer = () => {
    throw new RelightError({
      code: ErrorCode.ERROR_NOT_FOUND,
      text: "there is no change of yours to undo",
      hint: "`relight models` lists the models",
      retryAfterMs: 0,
    });
  };
  store.undo();
  await turn();
  expect(store.notice.value?.text).toBe("There is no change of yours to undo here.");
  expect(store.notice.value?.remedy).toBe("");
});
