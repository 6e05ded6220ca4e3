// SPDX-License-Identifier: MIT
// The connection is slow, or lost, while a person works in a room: what others changed meanwhile is a
// conflict, what is one's own is none, and all see the same.
import { create, toBinary } from "@bufbuild/protobuf";
import { beforeEach, expect, test } from "vitest";
import { fakeDaemon, tellState, turn } from "./fake-browser";
import { ErrorCode, RoomRole, RoomStateSchema, type RoomAction } from "../src/gen/relight_pb";
import { DisconnectedError, RelightError } from "../src/protocol/errors";
import { Type } from "../src/protocol/frame";
import type { SceneState } from "../src/state/scene-state";

const store = await import("../src/ui/store");
const here = await import("../src/room/here");
const session = await import("../src/room/session");
const { pump } = await import("../src/room/edits");
const { putDown } = await import("../src/room/share");
const daemon = fakeDaemon(store.client);
const { hello } = store.client;

interface Edit {
  number: bigint;
  action: RoomAction;
}
const edits = () =>
  daemon.asked
    .filter(({ type }) => type === Type.RoomEdit)
    .map(({ init }) => init as never as Edit);
const MODEL = "a".repeat(32);
const lit = (rotateDeg: number) => ({
  model: MODEL,
  lights: [{ env: "constant", rotateDeg, gain: { x: 1, y: 1, z: 1 } }],
});
function moves(part: Partial<SceneState>): void {
  store.set(part);
  putDown();
}
const turned = (rotate: number) => ({
  lamps: [{ env: "constant", rotate, tilt: 0, gain: [1, 1, 1] as [number, number, number] }],
});
const refusal = (code: ErrorCode) =>
  new RelightError({ code, text: "no", hint: "", retryAfterMs: 0 });
/** A daemon that keeps the sequence of the last change of each part. */
function room(first: bigint) {
  let sequence = first;
  const changed = new Map<string, bigint>();
  const take = (parts: readonly string[]) => {
    sequence++;
    for (const part of parts) changed.set(part, sequence);
    return sequence;
  };
  daemon.answer = (type, init) => {
    if (type !== Type.RoomEdit) return {};
    const { scene } = (init as never as Edit).action;
    const since = scene?.since ?? 0n;
    if (since && scene?.parts.some((part) => (changed.get(part) ?? 0n) > since))
      throw refusal(ErrorCode.ERROR_MISMATCH);
    return { sequence: take(scene?.parts ?? []) };
  };
  return { take };
}
function goOffline(): void {
  store.client.hello = null;
}
async function comeBack(): Promise<void> {
  store.client.hello = hello;
  await pump();
  await turn();
}

const rotated = () => store.scene.value.lamps[0]?.rotate;
let name = ""; // of the room
let n = 0;
beforeEach(async () => {
  store.client.hello = hello;
  daemon.answer = () => ({});
  if (here.roomId.value) session.leave();
  await turn();
  daemon.asked = [];
  name = `r${++n}`;
  session.enter(name);
  tellState(daemon, { room: name, sequence: 9n, scene: { ...lit(0), picture: {} } });
});

// The first change is on its way when the connection is lost; the second one follows it.
async function changesTwice(first: Partial<SceneState>, second: Partial<SceneState>) {
  daemon.answer = (type) => {
    if (type === Type.RoomEdit) throw new DisconnectedError();
    return {};
  };
  moves(first);
  await turn();
  goOffline();
  moves(second);
  await turn();
}

test("a change offline is no conflict with the own one before it", async () => {
  await changesTwice(turned(20), turned(40));
  room(9n);
  await comeBack();
  expect(here.conflict.value).toBe("");
  expect(edits().at(-1)?.action.scene?.scene?.lights[0]?.rotateDeg).toBe(40);
});

test("another person's change of the same part is one", async () => {
  await changesTwice(turned(20), { exposure: 2 });
  room(9n).take(["picture"]);
  await comeBack();
  expect(here.conflict.value).not.toBe("");
});

test("a change of an own part and one of another's: each by itself", async () => {
  await changesTwice(turned(20), { ...turned(40), exposure: 2 });
  room(9n).take(["picture"]);
  await comeBack();
  expect(here.conflict.value).not.toBe("");
  const last = edits().at(-1);
  expect(last?.action.scene?.parts).toEqual(["lights"]);
  expect(last?.action.scene?.scene?.lights[0]?.rotateDeg).toBe(40);
  const numbers = edits().map(({ number }) => number);
  expect(numbers).toEqual([...numbers].sort((a, b) => Number(a - b)));
});

test("a change that may be done is not replaced while the daemon is busy", async () => {
  await changesTwice(turned(20), turned(20));
  let tries = 0;
  daemon.answer = (type) => {
    if (type !== Type.RoomEdit) return {};
    if (!tries++) throw refusal(ErrorCode.ERROR_BUSY);
    return { sequence: 9n + BigInt(tries) };
  };
  store.client.hello = hello;
  void pump();
  await turn();
  moves(turned(60));
  await new Promise((done) => setTimeout(done, 350));
  const rotations = edits().map(({ action }) => action.scene?.scene?.lights[0]?.rotateDeg);
  expect(rotations).toEqual([20, 20, 20, 60]);
});

/** The first change is refused once; the second one follows while it waits. */
async function changesWhileBusy(before: () => void, between: () => void): Promise<void> {
  let tries = 0;
  const others = room(9n);
  const answer = daemon.answer;
  daemon.answer = (type, init) => {
    if (type === Type.RoomEdit && !tries++) throw refusal(ErrorCode.ERROR_BUSY);
    return answer(type, init);
  };
  before();
  moves(turned(20));
  store.client.hello = hello;
  void pump();
  await turn();
  between();
  moves(turned(60));
  others.take(["lights"]);
  await comeBack();
  await new Promise((done) => setTimeout(done, 350));
}
const nothing = () => undefined;

test.each([
  ["before the daemon was busy", goOffline, nothing],
  ["while the daemon was busy", nothing, goOffline],
])("another person's change is a conflict with one made offline %s", async (_, one, two) => {
  await changesWhileBusy(one, two);
  expect(here.conflict.value).not.toBe("");
});

test("what others changed is shown once the own change has its answer", async () => {
  let answer: (message: unknown) => void = () => undefined;
  const undone = { room: name, scene: { ...lit(77), picture: {} } };
  daemon.answer = (type) =>
    type === Type.RoomEdit
      ? new Promise((done) => (answer = done))
      : { sequence: 11n, role: RoomRole.ROLE_OWNER };
  daemon.payload = toBinary(
    RoomStateSchema,
    create(RoomStateSchema, { ...undone, sequence: 11n }),
  );
  moves({ exposure: 2 });
  await turn();
  tellState(daemon, { ...undone, sequence: 10n }); // by another person's undo
  expect(rotated()).toBe(0);
  answer({ sequence: 11n });
  await turn();
  expect(rotated()).toBe(77);
});
