// SPDX-License-Identifier: MIT
// A view whose daemon answers when the test says, in simulated time.
import { create, type MessageInitShape } from "@bufbuild/protobuf";
import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { ViewFrameSchema, type ViewFrame } from "../src/gen/relight_pb";
import type { Client } from "../src/protocol/client";
import { Type } from "../src/protocol/frame";
import { LightView } from "../src/scene/light-view";

beforeEach(() => vi.useFakeTimers({ now: 0 }));
afterEach(() => vi.useRealTimers());

type Answered = (answer: { message: ViewFrame; payload: Uint8Array }) => void;
function rig() {
  const delays: number[] = [];
  const sent: bigint[] = [];
  let answered: Answered | undefined;
  const client = {
    stream: (...all: unknown[]) => {
      answered = all[4] as Answered;
      return 1n;
    },
    notify: () => undefined,
    request: (type: Type, _: unknown, init: { sequence: bigint }) => {
      if (type === Type.ViewSet) sent.push(init.sequence);
      return Promise.resolve({ message: {}, payload: new Uint8Array(0) });
    },
  };
  const view = new LightView(
    client as unknown as Client,
    "model",
    true,
    {},
    new Uint8Array(0),
    {
      frame: (_, __, latencyMs) => delays.push(latencyMs),
      error: (error) => {
        throw error;
      },
    },
  );
  const frame = (sequence: bigint, more: MessageInitShape<typeof ViewFrameSchema> = {}) =>
    answered?.({
      message: create(ViewFrameSchema, { sequence, equal: true, ...more }),
      payload: new Uint8Array(0),
    });
  const turn = () => view.set(() => Promise.resolve({ state: {}, fields: ["shade.term"] }));
  return { view, delays, sent, frame, turn };
}
const pass = (ms: number) => vi.advanceTimersByTimeAsync(ms);

test("the delay of a frame is that of the state it shows, not of older ones that it replaces", async () => {
  const { view, delays, sent, frame, turn } = rig();
  frame(0n);
  // A hand on a link that takes 120 ms: several states are outstanding.
  turn();
  await pass(120);
  frame(1n);
  turn();
  await pass(120);
  frame(2n);
  turn();
  await pass(40);
  turn();
  await pass(40);
  turn();
  await pass(120);
  expect(sent).toEqual([1n, 2n, 3n, 4n, 5n]);
  frame(5n);
  expect(delays).toEqual([0, 120, 120, 120]);
  view.close();
});

test("a hand that moves on a link of 400 ms gets coarse frames, one that rests the exact one", async () => {
  const { view, sent, frame } = rig();
  view.useLevels(true);
  const levels: number[] = [];
  const turn = () =>
    view.set((level) => {
      levels.push(level);
      return Promise.resolve({ state: {}, fields: ["shade.term"] });
    });
  let answered = 0n;
  frame(0n);
  // Each frame comes 400 ms after its state.
  const later = async (ms: number, moves: boolean) => {
    for (let at = 0; at < ms; at += 50) {
      if (moves) turn();
      await pass(50);
      for (const sequence of sent.filter((one) => one > answered)) {
        answered = sequence;
        setTimeout(() => frame(sequence), 400);
      }
    }
  };
  await later(4000, true);
  expect(Math.max(...levels)).toBeGreaterThan(0);
  await later(2000, false);
  expect(levels.at(-1)).toBe(0);
  levels.length = 0;
  await later(50, true); // a single change is no hand that moves
  expect(levels).toEqual([0]);
  view.close();
});
