// SPDX-License-Identifier: MIT
import { expect, test } from "vitest";
import { create } from "@bufbuild/protobuf";
import { ModelInfoSchema, ModelState } from "../src/gen/relight_pb";
import { Type } from "../src/protocol/frame";
import type { Client } from "../src/protocol/client";
import { NO_STATUS, Viewer, type Status } from "../src/scene/viewer";
import { FIRST, FIRST_LAMP } from "../src/state/scene-state";
import { fromFragment, toFragment } from "../src/state/url";

test("a link keeps the colour of a weak light", () => {
  const gain: [number, number, number] = [0.015625, 0.0015625, 0.00078125];
  const back = fromFragment(toFragment({ ...FIRST, lamps: [{ ...FIRST_LAMP, gain }] }));
  back.lamps[0]?.gain.forEach((x, i) => expect(x / (gain[i] ?? 1)).toBeCloseTo(1, 3));
});

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
  let status: Status = NO_STATUS;
  const viewer = new Viewer(
    client as unknown as Client,
    { canvas, pictureCanvas: canvas },
    null,
    {
      status: (now) => (status = now),
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
  return { viewer, show, watched, cancelled, status: () => status };
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
