// SPDX-License-Identifier: MIT
// What a person writes in a room stays until the daemon has it.
import { beforeEach, expect, test, vi } from "vitest";
import { fakeDaemon, turn } from "./fake-browser";
import { ErrorCode } from "../src/gen/relight_pb";
import { RelightError } from "../src/protocol/errors";
import { Type } from "../src/protocol/frame";

const { client, notice } = await import("../src/ui/store");
const { roomId } = await import("../src/room/here");
const { createRoom } = await import("../src/room/session");
const { draftOf, sendDraft } = await import("../src/ui/drafts");
const daemon = fakeDaemon(client);

const reply = (text: string) => ({ reply: { target: 5n, text } });
const texts = () =>
  daemon.asked
    .filter(({ type }) => type === Type.RoomEdit)
    .map(({ init }) => (init as { action: { reply: { text: string } } }).action.reply)
    .map((one) => JSON.stringify(one, (_, value: unknown) => String(value)));

beforeEach(() => {
  roomId.value = "r1";
  daemon.asked = [];
  daemon.answer = () => ({ sequence: 12n });
});

test("a reply that is refused keeps its text; one that is taken has none", async () => {
  const draft = draftOf("reply 5");
  draft.text.value = "a longer thought";
  daemon.answer = () => {
    const code = ErrorCode.ERROR_FORBIDDEN;
    throw new RelightError({ code, text: "no", hint: "", retryAfterMs: 0 });
  };
  expect(await sendDraft(draft, reply)).toBeNull();
  expect(draft.text.value).toBe("a longer thought");
  daemon.answer = () => ({ sequence: 12n });
  expect((await sendDraft(draft, reply))?.sequence).toBe(12n);
  expect(draft.text.value).toBe("");
});

test("a text on its way is there, and is sent once; what is added meanwhile stays", async () => {
  const draft = draftOf("reply 6");
  draft.text.value = "first";
  let answer: (message: unknown) => void = () => undefined;
  daemon.answer = () => new Promise((done) => (answer = done));
  const first = sendDraft(draft, reply);
  await turn();
  expect(draft.text.value).toBe("first");
  expect(await sendDraft(draft, reply)).toBeNull();
  draft.text.value = "first and second";
  answer({ sequence: 13n });
  await first;
  expect(texts().length).toBe(1);
  expect(draft.text.value).toBe("first and second");
});

test("each room and each field has a text of its own", () => {
  draftOf("new pin").text.value = "here";
  expect(draftOf("reply 7").text.value).toBe("");
  roomId.value = "r2";
  expect(draftOf("new pin").text.value).toBe("");
  roomId.value = "r1";
  expect(draftOf("new pin").text.value).toBe("here");
});

test("a room that is refused is none, and the page says so", async () => {
  daemon.answer = () => {
    throw new Error("no more rooms");
  };
  expect(await createRoom("Bumps")).toBe(false);
  expect(notice.value?.text).toBe("no more rooms");
});

test("a room is made once, however often its button is pressed", async () => {
  let answer: (message: unknown) => void = () => undefined;
  daemon.answer = (type) =>
    type === Type.RoomCreate ? new Promise((done) => (answer = done)) : { complete: true };
  const both = [createRoom("Bumps"), createRoom("Bumps")];
  const made = () => daemon.asked.filter(({ type }) => type === Type.RoomCreate).length;
  await vi.waitFor(() => expect(made()).toBeGreaterThan(0));
  await new Promise((done) => setTimeout(done, 50));
  answer({ room: "r9" });
  expect(await Promise.all(both)).toEqual([true, true]);
  expect(made()).toBe(1);
  expect(roomId.value).toBe("r9");
});
