// SPDX-License-Identifier: MIT
import { expect, test } from "vitest";
import { create } from "@bufbuild/protobuf";
import { ModelInfoSchema, ModelState } from "../src/gen/relight_pb";
import { Type } from "../src/protocol/frame";
import type { Client } from "../src/protocol/client";
import { Viewer } from "../src/scene/viewer";
import { FIRST, FIRST_LAMP } from "../src/state/scene-state";

// A viewer of a daemon whose models all bake; what it watches and cancels.
function rig() {
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
      type === Type.Info
        ? Promise.resolve({
            message: create(ModelInfoSchema, {
              model: init.model,
              state: ModelState.MODEL_BAKING,
            }),
          })
        : Promise.resolve({ message: {}, payload: new Uint8Array(0) }),
    stream: (type: Type, _: unknown, init: { job: string }) => {
      if (type === Type.Watch) watched.push(init.job);
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
      fault: (error) => {
        throw error;
      },
      fine: () => undefined,
    },
  );
  const show = async (model: string) => {
    viewer.show({ ...FIRST, model, lamps: [{ ...FIRST_LAMP, env: "constant" }] });
    await new Promise((done) => setTimeout(done, 10));
  };
  return { viewer, show, watched, cancelled };
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
