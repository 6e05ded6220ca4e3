// SPDX-License-Identifier: MIT
import { expect, test } from "vitest";
import { create } from "@bufbuild/protobuf";
import { ErrorCode, ModelInfoSchema, ModelState } from "../src/gen/relight_pb";
import { RelightError } from "../src/protocol/errors";
import { Type } from "../src/protocol/frame";
import type { Client } from "../src/protocol/client";
import { Viewer } from "../src/scene/viewer";
import { FIRST, FIRST_LAMP } from "../src/state/scene-state";

type Ended = (error: Error) => void;
const busy = (retryAfterMs: number) =>
  new RelightError({ code: ErrorCode.ERROR_BUSY, text: "busy", hint: "", retryAfterMs });

// A viewer of a daemon whose models all bake; what it watches and cancels.
function rig(refusals: RelightError[] = []) {
  const faults: { text: string; again: boolean }[] = [];
  const views: ((error: Error) => void)[] = [];
  const watched: string[] = [];
  const cancelled: bigint[] = [];
  let id = 0n;
  const client = {
    hello: {},
    has: () => false,
    can: () => true,
    notify: () => undefined,
    cancel: (one: bigint) => cancelled.push(one),
    request: (type: Type, _: unknown, init: { model: string }) =>
      type === Type.Info && refusals.length
        ? Promise.reject(refusals.shift() ?? new Error())
        : type === Type.Info
          ? Promise.resolve({
              message: create(ModelInfoSchema, {
                model: init.model,
                state: ModelState.MODEL_BAKING,
              }),
            })
          : Promise.resolve({ message: {}, payload: new Uint8Array(0) }),
    stream: (type: Type, _: unknown, init: { job: string }, ...[, , ended]: Ended[]) => {
      if (type === Type.Watch) watched.push(init.job);
      if (type === Type.ViewOpen && ended) views.push(ended);
      return ++id;
    },
  };
  const canvas = { clientWidth: 64, clientHeight: 64 } as HTMLCanvasElement;
  const viewer = new Viewer(
    client as unknown as Client,
    { canvas, pictureCanvas: canvas },
    null,
    {
      status: () => undefined,
      info: () => undefined,
      fault: (error, again = false) => {
        if (!(error instanceof RelightError)) throw error;
        faults.push({ text: error.message, again });
      },
      fine: () => undefined,
    },
  );
  const show = async (model: string) => {
    viewer.show({ ...FIRST, model, lamps: [{ ...FIRST_LAMP, env: "constant" }] });
    await new Promise((done) => setTimeout(done, 10));
  };
  return { viewer, show, watched, cancelled, faults, views };
}

test("the bake of the model that is shown now is followed", async () => {
  const { show, watched, viewer } = rig();
  await show("a");
  await show("b");
  viewer.close();
  expect(watched).toEqual(["a", "b"]);
});

test("a closed viewer follows no bake", async () => {
  const { show, cancelled, viewer } = rig();
  await show("a");
  viewer.close();
  expect(cancelled.length).toBe(1);
});

test("a model that a busy daemon refused is opened again when it said", async () => {
  const { show, faults, watched, viewer } = rig([busy(300)]);
  await show("a");
  expect(faults).toEqual([{ text: "busy", again: true }]);
  expect(watched).toEqual([]);
  await new Promise((done) => setTimeout(done, 400));
  expect(watched).toEqual(["a"]);
  viewer.close();
});

test("a view that a busy daemon ended is opened again, unless it was closed", async () => {
  const { show, views, viewer } = rig();
  await show("a");
  views[0]?.(busy(300));
  await new Promise((done) => setTimeout(done, 400));
  expect(views.length).toBe(2);
  views[1]?.(busy(300));
  viewer.close();
  await new Promise((done) => setTimeout(done, 400));
  expect(views.length).toBe(2);
});
