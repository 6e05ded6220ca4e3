// SPDX-License-Identifier: MIT
// Other people of a room change this page: their hands move its scene, and its camera follows a leader.
import { create, toBinary, type MessageInitShape } from "@bufbuild/protobuf";
import { beforeEach, expect, test } from "vitest";
import { fakeDaemon, tellState, turn } from "./fake-browser";
import {
  EventKind,
  EventSchema,
  PresenceSchema,
  type ParticipantSchema,
} from "../src/gen/relight_pb";
import { Type } from "../src/protocol/frame";
import { place, type Frame } from "../src/scene/camera";
import type { Viewer } from "../src/scene/viewer";
import type { SceneState } from "../src/state/scene-state";

const store = await import("../src/ui/store");
const here = await import("../src/room/here");
const session = await import("../src/room/session");
const { putDown } = await import("../src/room/share");
const daemon = fakeDaemon(store.client);

const lit = (rotateDeg: number) => ({
  model: "a".repeat(32),
  lights: [{ env: "constant", rotateDeg, gain: { x: 1, y: 1, z: 1 } }],
});
const rotated = () => store.scene.value.lamps[0]?.rotate;
/** A message of the daemon about people: about all of them, or about those that changed. */
function tellPeople(
  participants: MessageInitShape<typeof ParticipantSchema>[],
  isAll = false,
): void {
  daemon.streams.at(-1)?.answered({
    message: create(EventSchema, { kind: EventKind.EVENT_ROOM_PRESENCE, lost: isAll }),
    payload: toBinary(PresenceSchema, create(PresenceSchema, { participants })),
  });
}

beforeEach(async () => {
  if (here.roomId.value) session.leave();
  await turn();
  session.enter("r1");
  tellState(daemon, { room: "r1", sequence: 1n, scene: lit(20) });
});

test.each([
  [
    "says so",
    () => tellPeople([{ key: 8n, gone: true, handParts: ["lights"], hand: lit(77) }]),
  ],
  ["is not among all", () => tellPeople([{ key: 9n, name: "Cy" }], true)],
  ["puts its hand down", () => tellPeople([{ key: 8n }])],
])("a hand moves the scene until its person %s", (_, end) => {
  tellPeople([{ key: 8n, handParts: ["lights"], hand: lit(77) }]);
  expect(rotated()).toBe(77);
  end();
  expect(rotated()).toBe(20);
});

test("the camera of the one who was followed does not become the room's", async () => {
  const at = (x: number) => ({ eye: { x, y: 0, z: 5 }, target: { x: 0, y: 0, z: 0 } });
  const frame: Frame = { centre: [0, 0, 0], radius: 1 };
  store.useViewer({
    framed: frame,
    placed: ({ orbit }: SceneState) => place(frame, orbit, 1),
    show: () => undefined,
  } as unknown as Viewer);
  tellState(daemon, { room: "r1", sequence: 2n, scene: { ...lit(20), camera: at(0) } });
  daemon.asked = [];
  for (const end of [() => session.follow(8n), () => tellPeople([{ key: 8n, gone: true }])]) {
    tellPeople([{ key: 8n, camera: at(5) }]);
    session.follow(8n);
    expect(store.scene.value.orbit.azimuth).toBeCloseTo(45, 4);
    end();
    expect(store.scene.value.orbit.azimuth).toBeCloseTo(0, 4);
    putDown();
    await turn();
    expect(daemon.asked.filter(({ type }) => type === Type.RoomEdit)).toEqual([]);
  }
});

test("who leads is followed until that ends; who leads follows nobody", () => {
  tellPeople([{ key: 8n, leads: true }]);
  expect(here.follows.value).toBe(8n);
  tellPeople([{ key: 8n, leads: false }]);
  expect(here.follows.value).toBe(0n);
  session.lead(true);
  tellPeople([{ key: 8n, leads: true }]);
  expect(here.follows.value).toBe(0n);
  session.lead(false);
  session.lookAlone(true);
  tellPeople([{ key: 9n, leads: true }]);
  expect(here.follows.value).toBe(0n);
});
