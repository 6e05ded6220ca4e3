// SPDX-License-Identifier: MIT
// A window without a page for node: its address and history, its storage and its listeners. It is
// there as soon as this file is imported; the store is imported after it.
import { create, toBinary, type MessageInitShape } from "@bufbuild/protobuf";
import { vi } from "vitest";
import {
  EventKind,
  EventSchema,
  HelloAnswerSchema,
  RoomRole,
  RoomStateSchema,
} from "../src/gen/relight_pb";
import type { Answer, Client } from "../src/protocol/client";
import type { Type } from "../src/protocol/frame";

interface Entry {
  url: string;
  state: unknown;
}

class FakeWindow {
  entries: Entry[] = [{ url: "http://daemon/", state: null }];
  at = 0;
  private readonly heard = new Map<string, ((event: unknown) => void)[]>();

  get entry(): Entry {
    return this.entries[this.at] ?? { url: "http://daemon/", state: null };
  }
  listen(kind: string, listener: (event: unknown) => void): void {
    this.heard.set(kind, [...(this.heard.get(kind) ?? []), listener]);
  }
  private popped(): void {
    for (const listener of this.heard.get("popstate") ?? [])
      listener({ state: this.entry.state });
  }
  put(state: unknown, url: string | URL | null | undefined, isNew: boolean): void {
    const entry = { url: new URL(url ?? "", this.entry.url).href, state };
    if (isNew) this.entries = [...this.entries.slice(0, this.at + 1), entry];
    else this.entries[this.at] = entry;
    if (isNew) this.at++;
  }
  /** The browser's Back (-1) and Forward (1). */
  go(by: number): void {
    this.at += by;
    this.popped();
  }
  /** A person closes the page; whether the browser asks first. */
  closing(): boolean {
    let asks = false;
    const event = { preventDefault: () => (asks = true) };
    for (const listener of this.heard.get("beforeunload") ?? []) listener(event);
    return asks;
  }
  /** A person types a fragment into the address. */
  type(fragment: string): void {
    this.put(null, fragment, true);
    this.popped();
  }
}

export const browser = new FakeWindow();

function storage() {
  const kept = new Map<string, string>();
  return {
    getItem: (key: string) => kept.get(key) ?? null,
    setItem: (key: string, value: string) => void kept.set(key, value),
    removeItem: (key: string) => void kept.delete(key),
  };
}

const url = () => new URL(browser.entry.url);
vi.stubGlobal("location", {
  get href() {
    return url().href;
  },
  get pathname() {
    return url().pathname;
  },
  get hash() {
    return url().hash;
  },
  get search() {
    return url().search;
  },
  protocol: "http:",
  host: "daemon",
});
vi.stubGlobal("history", {
  get state() {
    return browser.entry.state;
  },
  pushState: (state: unknown, _: string, to?: string | URL | null) =>
    browser.put(state, to, true),
  replaceState: (state: unknown, _: string, to?: string | URL | null) =>
    browser.put(state, to, false),
});
vi.stubGlobal("sessionStorage", storage());
vi.stubGlobal("localStorage", storage());
vi.stubGlobal("addEventListener", (kind: string, listener: (event: unknown) => void) =>
  browser.listen(kind, listener),
);

// ---- a daemon

type Answered = (answer: Answer<unknown>) => void;
/** The requests of the page, newest last, and the answers that it gets. */
export interface Daemon {
  asked: { type: Type; init: Record<string, unknown> }[];
  /** Answers a request; throws where it is refused. */
  answer: (type: Type, init: Record<string, unknown>) => unknown;
  /** Of its answers. */
  payload: Uint8Array;
  /** Frames without an answer. */
  told: { type: Type; init: Record<string, unknown> }[];
  /** Streams that the page opened. */
  streams: {
    type: Type;
    init: Record<string, unknown>;
    answered: Answered;
    ended: (error: Error | null) => void;
  }[];
}

/** Puts a daemon behind the store's client. */
export function fakeDaemon(client: Client): Daemon {
  const daemon: Daemon = {
    asked: [],
    answer: () => ({}),
    payload: new Uint8Array(0),
    told: [],
    streams: [],
  };
  client.hello = create(HelloAnswerSchema, { scopes: ["view", "upload"] });
  client.request = (async (type: Type, _: unknown, init: Record<string, unknown>) => {
    daemon.asked.push({ type, init });
    const message = await Promise.resolve(daemon.answer(type, init));
    return { message, payload: daemon.payload };
  }) as typeof client.request;
  client.stream = ((
    type: Type,
    _: unknown,
    init: Record<string, unknown>,
    __: unknown,
    answered: Answered,
    ended: (error: Error | null) => void,
  ) => {
    daemon.streams.push({ type, init, answered, ended });
    return BigInt(daemon.streams.length);
  }) as typeof client.stream;
  client.notify = ((type: Type, _: unknown, init: Record<string, unknown>) =>
    void daemon.told.push({ type, init })) as typeof client.notify;
  client.cancel = () => undefined;
  return daemon;
}

/** The daemon tells the state of the room in which the page sits. */
export function tellState(
  daemon: Daemon,
  init: MessageInitShape<typeof RoomStateSchema>,
): void {
  const seat = daemon.streams.filter(({ init: { room } }) => room !== undefined).at(-1);
  const state = create(RoomStateSchema, init);
  seat?.answered({
    message: create(EventSchema, {
      kind: EventKind.EVENT_ROOM_STATE,
      participant: 7n,
      role: RoomRole.ROLE_OWNER,
    }),
    payload: toBinary(RoomStateSchema, state),
  });
}

/** Until what was begun has gone on as far as it can. */
export const turn = () => new Promise((done) => setTimeout(done, 5));
