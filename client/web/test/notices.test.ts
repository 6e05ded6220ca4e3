// SPDX-License-Identifier: MIT
// Messages end with their own cause, and not before.
import { beforeEach, expect, test } from "vitest";
import { fakeDaemon } from "./fake-browser";
import type { ConnectionState } from "../src/protocol/client";

const store = await import("../src/ui/store");
fakeDaemon(store.client);
const VIEW = Symbol("view");

beforeEach(() => {
  store.notice.value = null;
});

test("a frame does not clear the fault of an upload", () => {
  store.fault(new Error("the file is larger than the daemon allows"));
  store.fine(VIEW);
  expect(store.notice.value?.text).toMatch(/larger/);
});

test("a frame clears the fault of its own view", () => {
  store.fault(new Error("the model has no light"), VIEW);
  store.fine(Symbol("another view"));
  expect(store.notice.value).not.toBeNull();
  store.fine(VIEW);
  expect(store.notice.value).toBeNull();
});

test("a view does not clear the fault that came after its own", () => {
  store.fault(new Error("the model has no light"), VIEW);
  store.fault(new Error("the upload was refused"));
  store.fine(VIEW);
  expect(store.notice.value?.text).toMatch(/upload/);
});

test("a page that is offline says so while it tries to connect, too", () => {
  const changed = (store.client as unknown as { changed: (state: ConnectionState) => void })
    .changed;
  changed({ is: "connecting" });
  changed({ is: "offline", retryAtMs: 0 });
  changed({ is: "connecting" });
  expect(store.connection.value.is).toBe("offline");
});
