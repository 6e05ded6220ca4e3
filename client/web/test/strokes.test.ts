// SPDX-License-Identifier: MIT
// A stroke that the daemon refuses stays on the page until a person sends it again or drops it.
import { beforeEach, expect, test } from "vitest";
import { fakeDaemon, turn } from "./fake-browser";
import { ErrorCode } from "../src/gen/relight_pb";
import { RelightError } from "../src/protocol/errors";
import type { Point } from "../src/room/pick";

const { client } = await import("../src/ui/store");
const { roomId } = await import("../src/room/here");
const { dropStroke, ownStrokes, refusedStrokes, sendAgain, sendStroke } =
  await import("../src/ui/strokes");
const daemon = fakeDaemon(client);
const line = [0, 1, 2].map((x) => ({ position: [x, 0, 0] }) as unknown as Point);
const refuse = () => {
  const code = ErrorCode.ERROR_FORBIDDEN;
  throw new RelightError({ code, text: "no", hint: "", retryAfterMs: 0 });
};

beforeEach(() => {
  ownStrokes().forEach(dropStroke);
  roomId.value = "r1";
  daemon.asked = [];
  daemon.answer = () => ({ sequence: 12n });
});

test("a stroke is drawn until the daemon has it", async () => {
  const sent = sendStroke(line, 0n);
  expect(ownStrokes().length).toBe(1);
  await sent;
  expect(ownStrokes()).toEqual([]);
});

test("a refused stroke can be sent again, with its points and pin", async () => {
  daemon.answer = refuse;
  await sendStroke(line, 7n);
  await sendStroke(line, 0n);
  expect(refusedStrokes(7n).map(({ points }) => points)).toEqual([line]);
  daemon.answer = () => ({ sequence: 12n });
  daemon.asked = [];
  refusedStrokes(7n).forEach(sendAgain);
  expect(refusedStrokes(7n)).toEqual([]);
  await turn();
  expect(daemon.asked.map(({ init }) => init)).toMatchObject([
    { action: { stroke: { pin: 7n, points: [{ position: { x: 0 } }, {}, {}] } } },
  ]);
  expect(ownStrokes().map(({ pin }) => pin)).toEqual([0n]);
});

test("a refused stroke is of its room", async () => {
  daemon.answer = refuse;
  await sendStroke(line, 0n);
  roomId.value = "r2";
  expect(ownStrokes()).toEqual([]);
  roomId.value = "r1";
  refusedStrokes(0n).forEach(dropStroke);
  expect(ownStrokes()).toEqual([]);
});
