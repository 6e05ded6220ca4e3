// SPDX-License-Identifier: MIT
// The connection of the page over a socket that the test holds.
import { create, toBinary } from "@bufbuild/protobuf";
import { afterEach, expect, test, vi } from "vitest";
import {
  ErrorCode,
  ErrorSchema,
  HelloAnswerSchema,
  PingAnswerSchema,
  PingRequestSchema,
  WatchRequestSchema,
  ProgressSchema,
} from "../src/gen/relight_pb";
import { Client, type ConnectionState } from "../src/protocol/client";
import { DisconnectedError } from "../src/protocol/errors";
import { ANSWER, decodeFrame, encodeFrame, Type } from "../src/protocol/frame";

const sockets: FakeSocket[] = [];
class FakeSocket {
  static readonly OPEN = 1;
  readyState = FakeSocket.OPEN;
  bufferedAmount = 0;
  onopen = (): void => undefined;
  onmessage: ((event: { data: ArrayBuffer }) => void) | null = null;
  onclose = (): void => undefined;
  readonly sent: { type: number; id: bigint }[] = [];
  constructor() {
    sockets.push(this);
  }
  send(bytes: Uint8Array<ArrayBuffer>): void {
    this.sent.push(decodeFrame(bytes.slice().buffer));
  }
  close(): void {
    this.readyState = 3;
  }
  refuse(id: bigint, header: Uint8Array): void {
    const bytes = encodeFrame(Type.Error, id, header) as Uint8Array<ArrayBuffer>;
    this.onmessage?.({ data: bytes.buffer });
  }
  answer(type: Type, id: bigint, header: Uint8Array): void {
    const bytes = encodeFrame(type | ANSWER, id, header) as Uint8Array<ArrayBuffer>;
    this.onmessage?.({ data: bytes.buffer });
  }
}
vi.stubGlobal("WebSocket", FakeSocket);

const turn = () => new Promise((done) => setTimeout(done, 0));
let client: Client | null = null;
async function connected(): Promise<Client> {
  const made = (client = new Client("ws://daemon/ws"));
  made.connect();
  await greeted();
  return made;
}
async function greeted(): Promise<void> {
  const socket = sockets.at(-1);
  socket?.onopen();
  const hello = toBinary(HelloAnswerSchema, create(HelloAnswerSchema, {}));
  socket?.answer(Type.Hello, socket.sent.at(-1)?.id ?? 0n, hello);
  await turn();
}
afterEach(() => client?.close());

test("what awaits an answer fails, once, when the connection is made anew", async () => {
  const made = await connected();
  const ended: unknown[] = [];
  const note = (error: unknown) => ended.push(error);
  made.request(Type.Ping, PingRequestSchema, {}, PingAnswerSchema).catch(note);
  made.stream(
    Type.Watch,
    WatchRequestSchema,
    { job: "a" },
    ProgressSchema,
    () => undefined,
    note,
  );
  made.useToken("another");
  await turn();
  expect(ended.length).toBe(2);
  expect(ended.every((error) => error instanceof DisconnectedError)).toBe(true);
  await greeted();
  made.useToken("a third");
  await turn();
  expect(ended.length).toBe(2);
});

test("a daemon that refuses a greeting for now says why, and is asked when it said", async () => {
  const states: ConnectionState[] = [];
  const made = (client = new Client("ws://daemon/ws", { changed: (one) => states.push(one) }));
  made.connect();
  const socket = sockets.at(-1);
  socket?.onopen();
  const error = create(ErrorSchema, {
    code: ErrorCode.ERROR_BUSY,
    text: "too many wrong tokens",
    retryAfterMs: 20_000,
  });
  socket?.refuse(socket.sent.at(-1)?.id ?? 0n, toBinary(ErrorSchema, error));
  await turn();
  socket?.onclose();
  const last = states.at(-1);
  expect(last).toMatchObject({ is: "offline", why: { message: "too many wrong tokens" } });
  expect(last?.is === "offline" && last.retryAtMs - Date.now()).toBeGreaterThan(15_000);
});
