// SPDX-License-Identifier: MIT
// One WebSocket to a relightd: requests with ids, answers in any order, streams of answers, and
// connecting again by itself.
import {
  create,
  fromBinary,
  toBinary,
  type DescMessage,
  type MessageShape,
} from "@bufbuild/protobuf";
import {
  CancelRequestSchema,
  ErrorSchema,
  ErrorCode,
  GoawaySchema,
  HelloAnswerSchema,
  HelloRequestSchema,
  PingAnswerSchema,
  PingRequestSchema,
  type HelloAnswer,
} from "../gen/relight_pb";
import { busyMs } from "./busy";
import { DisconnectedError, RelightError } from "./errors";
import {
  ANSWER,
  FLAG_LAST,
  FLAG_MORE,
  Type,
  decodeFrame,
  encodeFrame,
  type Frame,
} from "./frame";

export type ConnectionState =
  | { is: "connecting" }
  | { is: "ready"; hello: HelloAnswer }
  /** why: the daemon refused the greeting for now; missing: it did not answer. */
  | { is: "offline"; retryAtMs: number; why?: RelightError }
  | { is: "refused"; error: RelightError };

/** An answer: its message, and its payload in memory of its own. */
export interface Answer<T> {
  message: T;
  payload: Uint8Array;
}

interface Pending {
  header: Uint8Array | null;
  parts: Uint8Array[];
  answered: (header: Uint8Array, payload: Uint8Array, last: boolean) => void;
  failed: (error: Error) => void;
}

/** The part of a message's fields that `create` takes. */
type Init<S extends DescMessage> = Parameters<typeof create<S>>[1];

const RETRY_FIRST_MS = 400;
const RETRY_MOST_MS = 8000;
const PING_MS = 60000;
// Wait between GOAWAY and the new connection [ms], where replicas share their models. Within it the health checks of
// a proxy have found that this daemon stops, and the proxy chooses another.
const LEAVE_MS = 1200;
const MOST_PATH = 120; // characters of a model in a path

export class Client {
  readonly url: string;
  /** Bytes received, for a display of the rate. */
  received = 0;
  hello: HelloAnswer | null = null;
  private token: string;
  private socket: WebSocket | null = null;
  private lastId = 0n;
  private pending = new Map<bigint, Pending>();
  private retryMs = RETRY_FIRST_MS;
  private retryTimer: ReturnType<typeof setTimeout> | undefined;
  private leaveTimer: ReturnType<typeof setTimeout> | undefined;
  private pingTimer: ReturnType<typeof setInterval> | undefined;
  private closed = false;
  private wanted = ""; // the model that is looked at
  private route = ""; // the model in the path of this connection
  private why: RelightError | null = null; // for which this connection will end
  private readonly name: string;
  private readonly changed: (state: ConnectionState) => void;

  /** url "ws://host/ws". `changed` is called with every state of the connection; after "ready"
   * all views and subscriptions have to be opened anew. */
  constructor(
    url: string,
    options: { token?: string; name?: string; changed?: (state: ConnectionState) => void } = {},
  ) {
    this.url = url;
    this.token = options.token ?? "";
    this.name = options.name ?? "relight-web 0.1.0";
    this.changed = options.changed ?? (() => undefined);
  }

  /** Connects, and again after each loss, until close(). */
  connect(): void {
    clearTimeout(this.retryTimer);
    if (this.closed || this.socket) return;
    this.changed({ is: "connecting" });
    const socket = new WebSocket(this.url + this.path(), "relight.v1");
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => void this.greet(socket);
    socket.onmessage = (event) => this.receive(event.data as ArrayBuffer);
    socket.onclose = () => this.lost(socket);
  }

  /** The token of the next connection; connects now. */
  useToken(token: string): void {
    this.token = token;
    this.reconnect();
  }

  /** The model that is looked at. Where replicas share their models a proxy may choose one by the
   * path of the WebSocket: the connection is made anew. */
  lookAt(model: string): void {
    this.wanted = model;
    if (this.isElsewhere(this.hello)) this.reroute();
  }
  private path(): string {
    const word = encodeURIComponent(this.route);
    return word && word.length <= MOST_PATH ? `/${word}` : "";
  }
  private reroute(): void {
    this.route = this.wanted;
    this.reconnect();
  }
  private isElsewhere(hello: HelloAnswer | null): boolean {
    return hello !== null && hello.shares && this.wanted !== "" && this.wanted !== this.route;
  }

  private reconnect(): void {
    clearTimeout(this.leaveTimer);
    this.retryMs = RETRY_FIRST_MS;
    const socket = this.socket;
    this.socket = null;
    this.hello = null;
    clearInterval(this.pingTimer);
    this.failAll(new DisconnectedError());
    socket?.close();
    this.connect();
  }

  close(): void {
    this.closed = true;
    clearTimeout(this.retryTimer);
    clearTimeout(this.leaveTimer);
    clearInterval(this.pingTimer);
    this.socket?.close();
    this.socket = null;
    this.failAll(new DisconnectedError());
  }

  can(scope: string): boolean {
    return this.hello?.scopes.includes(scope) ?? false;
  }
  has(feature: string): boolean {
    return this.hello?.features.includes(feature) ?? false;
  }

  /** Bytes that the browser has not sent yet. */
  get unsent(): number {
    return this.socket?.bufferedAmount ?? 0;
  }

  /** One request, one answer. */
  async request<Q extends DescMessage, A extends DescMessage>(
    type: Type,
    question: Q,
    init: Init<Q>,
    answer: A,
    payload?: Uint8Array,
    deadlineMs = 0,
  ): Promise<Answer<MessageShape<A>>> {
    return new Promise((resolve, reject) => {
      this.send(type, question, init, payload, deadlineMs, {
        header: null,
        parts: [],
        answered: (header, bytes) =>
          resolve({ message: fromBinary(answer, header), payload: bytes }),
        failed: reject,
      });
    });
  }

  /** A request with several answers: its id, for CANCEL or for VIEW_SET. `ended` has the error, or
   * null after an answer that was the last. */
  stream<Q extends DescMessage, A extends DescMessage>(
    type: Type,
    question: Q,
    init: Init<Q>,
    answer: A,
    answered: (answer: Answer<MessageShape<A>>) => void,
    ended: (error: Error | null) => void,
    payload?: Uint8Array,
  ): bigint {
    return this.send(type, question, init, payload, 0, {
      header: null,
      parts: [],
      answered: (header, bytes, last) => {
        answered({ message: fromBinary(answer, header), payload: bytes });
        if (last) ended(null);
      },
      failed: ended,
    });
  }

  /** Ends a stream. */
  cancel(id: bigint): void {
    this.pending.delete(id);
    this.notify(Type.Cancel, CancelRequestSchema, { id });
  }

  /** A one-way frame. */
  notify<Q extends DescMessage>(type: Type, question: Q, init: Init<Q>): void {
    if (this.hello) this.transmit(type, 0n, question, init);
  }

  private transmit<Q extends DescMessage>(
    type: Type,
    id: bigint,
    question: Q,
    init: Init<Q>,
    payload?: Uint8Array,
    deadlineMs = 0,
  ): void {
    const header = toBinary(question, create(question, init));
    this.socket?.send(
      encodeFrame(type, id, header, payload, deadlineMs) as Uint8Array<ArrayBuffer>,
    );
  }

  private send<Q extends DescMessage>(
    type: Type,
    question: Q,
    init: Init<Q>,
    payload: Uint8Array | undefined,
    deadlineMs: number,
    pending: Pending,
  ): bigint {
    const id = ++this.lastId;
    const open = this.socket?.readyState === WebSocket.OPEN;
    if (!open || (!this.hello && type !== Type.Hello)) {
      queueMicrotask(() => pending.failed(new DisconnectedError()));
      return id;
    }
    this.pending.set(id, pending);
    this.transmit(type, id, question, init, payload, deadlineMs);
    return id;
  }

  private async greet(socket: WebSocket): Promise<void> {
    try {
      const { message } = await this.request(
        Type.Hello,
        HelloRequestSchema,
        { client: this.name, versionMin: 1, versionMax: 1, token: this.token },
        HelloAnswerSchema,
      );
      if (this.socket !== socket) return;
      if (this.isElsewhere(message)) {
        this.reroute();
        return;
      }
      this.hello = message;
      this.retryMs = RETRY_FIRST_MS;
      clearInterval(this.pingTimer);
      this.pingTimer = setInterval(() => this.notifyPing(), PING_MS);
      this.changed({ is: "ready", hello: message });
    } catch (error) {
      this.refused(error);
    }
  }

  private refused(error: unknown): void {
    if (!(error instanceof RelightError)) return;
    if (error.code !== ErrorCode.ERROR_FORBIDDEN) {
      this.why = error; // the daemon ends the connection
      return;
    }
    const socket = this.socket;
    this.socket = null; // not tried again with the same token
    socket?.close();
    this.changed({ is: "refused", error });
  }

  // Keeps the connection: the daemon closes one without frames after --idle.
  private notifyPing(): void {
    this.request(Type.Ping, PingRequestSchema, {}, PingAnswerSchema).catch(() => undefined);
  }

  private lost(socket: WebSocket): void {
    if (this.socket !== socket) return;
    this.socket = null;
    this.hello = null;
    clearTimeout(this.leaveTimer);
    clearInterval(this.pingTimer);
    this.failAll(new DisconnectedError());
    if (this.closed) return;
    const { why } = this;
    this.why = null;
    const wait = Math.max(this.retryMs * (0.8 + 0.4 * Math.random()), busyMs(why) ?? 0);
    this.retryMs = Math.min(this.retryMs * 1.7, RETRY_MOST_MS);
    this.retryTimer = setTimeout(() => this.connect(), wait);
    this.changed({ is: "offline", retryAtMs: Date.now() + wait, ...(why ? { why } : {}) });
  }

  private failAll(error: Error): void {
    const all = [...this.pending.values()];
    this.pending.clear();
    for (const pending of all) pending.failed(error);
  }

  private receive(message: ArrayBuffer): void {
    this.received += message.byteLength;
    let frame: Frame;
    try {
      frame = decodeFrame(message);
    } catch {
      this.socket?.close();
      return;
    }
    if (frame.type === Type.Goaway) {
      const { drainMs } = fromBinary(GoawaySchema, frame.header);
      this.retryMs = Math.max(RETRY_FIRST_MS, Math.min(drainMs, 2000));
      this.leave(drainMs);
      return;
    }
    if (frame.type === Type.Error) this.receiveError(frame);
    else if (frame.type & ANSWER) this.receiveAnswer(frame);
  }

  // Where replicas share their models another one goes on, before this one ends. Not all clients at once.
  private leave(drainMs: number): void {
    if (!this.hello?.shares) return;
    const wait = Math.min(LEAVE_MS, drainMs / 3) * (0.8 + 0.4 * Math.random());
    clearTimeout(this.leaveTimer);
    this.leaveTimer = setTimeout(() => this.reconnect(), wait);
  }

  private receiveError(frame: Frame): void {
    const error = new RelightError(fromBinary(ErrorSchema, frame.header));
    const pending = this.pending.get(frame.id);
    this.pending.delete(frame.id);
    if (pending) pending.failed(error);
    else if (frame.id === 0n) this.refused(error); // of the connection: a revoked token
  }

  private receiveAnswer(frame: Frame): void {
    const pending = this.pending.get(frame.id);
    if (!pending) return;
    pending.header ??= frame.header;
    pending.parts.push(frame.payload);
    if (frame.flags & FLAG_MORE) return;
    const header = pending.header;
    const payload = joined(pending.parts);
    pending.header = null;
    pending.parts = [];
    const last = (frame.flags & FLAG_LAST) !== 0;
    if (last) this.pending.delete(frame.id);
    pending.answered(header, payload, last);
  }
}

function joined(parts: Uint8Array[]): Uint8Array {
  if (parts.length === 1 && parts[0]) return parts[0];
  const all = new Uint8Array(parts.reduce((n, part) => n + part.length, 0));
  let at = 0;
  for (const part of parts) {
    all.set(part, at);
    at += part.length;
  }
  return all;
}
