// SPDX-License-Identifier: MIT
// A request that a busy daemon refuses is repeated after the time that the daemon names; the message
// says so only where the page does it.
import { beforeEach, expect, test } from "vitest";
import { browser, fakeDaemon, tellState } from "./fake-browser";
import { ErrorCode } from "../src/gen/relight_pb";
import { busyMs, whenFree } from "../src/protocol/busy";
import { explain, RelightError } from "../src/protocol/errors";
import { Type } from "../src/protocol/frame";

const store = await import("../src/ui/store");
const here = await import("../src/room/here");
const session = await import("../src/room/session");
const { edit } = await import("../src/room/edits");
const daemon = fakeDaemon(store.client);

const busy = (retryAfterMs: number) =>
  new RelightError({
    code: ErrorCode.ERROR_BUSY,
    text: "12 requests wait",
    hint: "repeat the request after retry_after_ms",
    retryAfterMs,
  });
const LIST = { models: [{ name: "bunny", model: "b" }], environments: [], files: [] };
// Refuses the first requests of a type; the times of all of them [ms].
function refuseFirst(type: Type, n: number, answer: unknown): number[] {
  const times: number[] = [];
  daemon.answer = (one) => {
    if (one !== type) return {};
    times.push(performance.now());
    if (times.length <= n) throw busy(300);
    return answer;
  };
  return times;
}

beforeEach(() => {
  store.notice.value = null;
  daemon.answer = () => ({});
});

test("the time is the daemon's, within limits; other faults have none", () => {
  expect(busyMs(busy(700))).toBe(700);
  expect(busyMs(busy(0))).toBeGreaterThan(0);
  expect(busyMs(busy(1e9))).toBeLessThan(60_000);
  expect(busyMs(new Error("no"))).toBeNull();
});

test("an answer that nobody wants any more is not asked for again", async () => {
  let n = 0;
  const ask = () => Promise.reject(busy(++n));
  await expect(whenFree(ask, () => false)).rejects.toThrow("12 requests wait");
  expect(n).toBe(1);
});

test("words: tried again by itself only where it is", () => {
  expect(explain(busy(2300), true).remedy).toBe("It is tried again by itself.");
  expect(explain(busy(2300)).remedy).toBe("Try it again in 3 s.");
});

test("the list of models is read again, and its message ends then", async () => {
  const times = refuseFirst(Type.List, 2, LIST);
  const read = store.refresh();
  await new Promise((done) => setTimeout(done, 50));
  expect(store.notice.value).toMatchObject({
    kind: "busy",
    remedy: "It is tried again by itself.",
  });
  await read;
  expect(times.length).toBe(3);
  expect((times[1] ?? 0) - (times[0] ?? 0)).toBeGreaterThanOrEqual(290);
  expect(store.models.value?.length).toBe(1);
  expect(store.notice.value).toBeNull();
});

test("the list of models has all answers", async () => {
  daemon.answer = (_, { after }) =>
    after
      ? { models: [{ name: "last", model: "l" }], next: 0n }
      : { ...LIST, files: [{ path: "a.prt" }], next: 7n };
  await store.refresh();
  expect(store.models.value?.map(({ name }) => name)).toEqual(["bunny", "last"]);
  expect(store.files.value).toEqual(["a.prt"]);
});

test("the list of rooms is read again", async () => {
  refuseFirst(Type.RoomList, 1, { rooms: [] });
  here.rooms.value = null;
  await session.listRooms();
  expect(here.rooms.value).toEqual([]);
});

test("a list of rooms that is not whole says so", async () => {
  daemon.answer = () => ({ rooms: [{ room: "new" }], more: true });
  await session.listRooms();
  expect(here.roomsMore.value).toBe(true);
  daemon.answer = () => ({ rooms: [], more: false });
  await session.listRooms();
  expect(here.roomsMore.value).toBe(false);
});

test("a change in a room is sent again, with the same number", async () => {
  here.roomId.value = "r1";
  daemon.asked = [];
  refuseFirst(Type.RoomEdit, 1, { sequence: 4n });
  const kept = edit({ save: { note: "as it came" } });
  expect(browser.closing()).toBe(false); // it is on its way
  await new Promise((done) => setTimeout(done, 50));
  expect(browser.closing()).toBe(true); // the daemon has not taken it
  await kept;
  expect(browser.closing()).toBe(false);
  const numbers = daemon.asked.map(({ init }) => init["number"]);
  expect(numbers.length).toBe(2);
  expect(numbers[0]).toBe(numbers[1]);
  here.roomId.value = "";
});

test("a seat in a room is taken again", async () => {
  session.enter("r2");
  const seats = () => daemon.streams.filter(({ init }) => init["room"] === "r2").length;
  daemon.streams.at(-1)?.ended(busy(300));
  expect(store.notice.value?.kind).toBe("busy");
  await new Promise((done) => setTimeout(done, 400));
  expect(seats()).toBe(2);
  tellState(daemon, { room: "r2", sequence: 1n });
  expect(store.notice.value).toBeNull();
  expect(here.state.value?.room).toBe("r2");
  session.leave();
});

test("a light of the page that a room needs is uploaded again", async () => {
  session.enter("r3");
  tellState(daemon, { room: "r3", sequence: 1n, scene: { model: "a".repeat(32) } });
  const times = refuseFirst(Type.PutBlob, 1, { complete: true, hash: "b".repeat(64) });
  store.set({ lamps: [{ env: "page:rim", rotate: 0, tilt: 0, gain: [1, 1, 1] }] });
  await new Promise((done) => setTimeout(done, 1200));
  expect(times.length).toBe(2);
  expect(store.notice.value).toBeNull();
  session.leave();
});

test("a list that comes after a newer one is not shown", async () => {
  const answers: ((message: unknown) => void)[] = [];
  daemon.answer = () => new Promise((done) => answers.push(done));
  const both = [store.refresh(), store.refresh()];
  const roomLists = [session.listRooms(), session.listRooms()];
  const list = (name: string) => ({
    models: [{ name, model: name }],
    environments: [],
    files: [],
  });
  const rooms = (room: string) => ({ rooms: [{ room }] });
  answers[1]?.(list("new"));
  answers[0]?.(list("old"));
  answers[3]?.(rooms("new"));
  answers[2]?.(rooms("old"));
  await Promise.all([...both, ...roomLists]);
  expect(store.models.value?.map(({ model }) => model)).toEqual(["new"]);
  expect(here.rooms.value?.map(({ room }) => room)).toEqual(["new"]);
});
