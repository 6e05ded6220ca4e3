// SPDX-License-Identifier: MIT
// Files that a person drops on the page: on a bad network they arrive all the same.
import { create } from "@bufbuild/protobuf";
import { beforeEach, expect, test, vi } from "vitest";
import { fakeDaemon, turn } from "./fake-browser";
import { ModelInfoSchema } from "../src/gen/relight_pb";
import { DisconnectedError } from "../src/protocol/errors";
import { Type } from "../src/protocol/frame";

const store = await import("../src/ui/store");
const daemon = fakeDaemon(store.client);
const hello = store.client.hello;

const light = (name: string) => new File(["light"], name);
const sent = () => daemon.asked.filter(({ type }) => type === Type.PutBlob).length;
// The connection is lost with the first request of a file.
async function loseFirst() {
  const taken = store.takeFiles([light("sky.hdr")]);
  daemon.answer = () => {
    daemon.answer = () => ({ complete: true });
    store.client.hello = null;
    store.connection.value = { is: "offline", retryAtMs: 0 };
    throw new DisconnectedError();
  };
  await vi.waitFor(() => expect(store.connection.value.is).toBe("offline"));
  await turn();
  return { taken };
}
function comeBack(): void {
  store.client.hello = hello;
  if (hello) store.connection.value = { is: "ready", hello };
}

beforeEach(() => {
  comeBack();
  store.notice.value = null;
  daemon.asked = [];
});

test("a file goes on when the connection is back", async () => {
  const { taken } = await loseFirst();
  expect(store.uploading.value?.name).toBe("sky.hdr");
  expect(store.notice.value).toBeNull();
  comeBack();
  await taken;
  expect(store.scene.value.lamps[0]?.env).toMatch(/^env:/);
  expect(store.uploading.value).toBeNull();
});

test.each([
  ["cancels it", () => (store.uploading.value = { name: "", share: 0, cancelled: true })],
  ["is refused", () => (store.connection.value = { is: "refused", error: null as never })],
])("a file is given up while there is no connection when its person %s", async (_, end) => {
  const { taken } = await loseFirst();
  end();
  await taken;
  expect(sent()).toBe(1);
  expect(store.uploading.value).toBeNull();
});

test("a file that is dropped while another is sent waits for it", async () => {
  let answer: (message: unknown) => void = () => undefined;
  daemon.answer = () => new Promise((done) => (answer = done));
  const first = store.takeFiles([light("sky.hdr")]);
  await vi.waitFor(() => expect(sent()).toBe(1));
  const second = store.takeFiles([light("room.hdr")]);
  await new Promise((done) => setTimeout(done, 50));
  expect(store.uploading.value?.name).toBe("sky.hdr");
  daemon.answer = () => ({ complete: true });
  answer({ complete: true });
  await first;
  await second;
  expect(sent()).toBe(2);
  expect(store.uploading.value).toBeNull();
});

test("a file that is neither says so, and not that the page is to be reloaded", async () => {
  await store.takeFiles([new File(["words"], "words.txt")]);
  expect(store.notice.value?.text).toMatch(/words\.txt is no model/);
  expect(store.notice.value?.remedy).toBe("");
});

test("a light that is dropped takes the place of the one that is chosen", async () => {
  daemon.answer = (type) =>
    type === Type.PutBlob
      ? { complete: true }
      : { models: [{ name: "m", model: "m" }], environments: [], files: [] };
  const lamp = {
    env: "constant",
    rotate: 30,
    tilt: 0,
    gain: [1, 1, 1] as [number, number, number],
  };
  store.set({ lamps: [lamp, { ...lamp, rotate: 60 }] });
  store.chosenLamp.value = 1;
  await store.takeFiles([light("sky.hdr")]);
  expect(store.scene.value.lamps[0]).toEqual(lamp);
  expect(store.scene.value.lamps[1]?.env).toMatch(/^env:/);
  store.set({ lamps: [lamp] }); // the second one was removed
  await store.takeFiles([light("room.hdr")]);
  expect(store.scene.value.lamps.map(({ env }) => env.slice(0, 4))).toEqual(["env:"]);
});

test("a file whose name ends as that of a model is listed all the same", () => {
  store.models.value = [create(ModelInfoSchema, { model: "m", name: "marble.prt" })];
  store.files.value = ["marble.prt", "old/marble.prt", "warm-marble.prt", "marble.obj"];
  expect(store.unloadedFiles.value).toEqual(["old/marble.prt", "warm-marble.prt"]);
});

test("each of two models of one name can be chosen", () => {
  store.models.value = ["a", "b", "c"].map((model) =>
    create(ModelInfoSchema, { model, name: model === "c" ? "cow" : "bunny" }),
  );
  store.files.value = [];
  expect(store.models.value.map(store.wordOf)).toEqual(["a", "b", "cow"]);
  store.files.value = ["cow", "old/cow"]; // the daemon calls both so
  expect(store.models.value.map(store.wordOf)).toEqual(["a", "b", "c"]);
});

test("a model that is cancelled when the daemon has it already is not loaded", async () => {
  daemon.answer = () => {
    if (store.uploading.value)
      store.uploading.value = { ...store.uploading.value, cancelled: true };
    return { complete: true };
  };
  await store.takeFiles([new File(["v 0 0 0"], "cow.obj")]);
  expect(sent()).toBe(1);
  expect(daemon.asked.filter(({ type }) => type === Type.Load)).toEqual([]);
  expect(store.notice.value).toBeNull();
});
