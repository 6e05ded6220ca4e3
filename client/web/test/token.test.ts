// SPDX-License-Identifier: MIT
// The token of a link is a secret: it goes out of the address before anything else reads that.
import { expect, test, vi } from "vitest";
import { browser } from "./fake-browser";

browser.entries = [{ url: "http://daemon/#token=relight_secret&model=bunny", state: null }];
const store = await import("../src/ui/store");

test("the token of a link is kept for the tab, and is in no address", () => {
  expect(browser.entries.map(({ url }) => url).join(" ")).not.toContain("relight_secret");
  expect(store.scene.value.model).toBe("bunny");
  expect(sessionStorage.getItem("relight-token")).toBe("relight_secret");
  expect(localStorage.getItem("relight-token")).toBeNull();
});

test("a token is kept for longer only where a person asks", () => {
  store.client.connect = () => undefined; // there is no daemon
  store.useToken("relight_other", true);
  expect(localStorage.getItem("relight-token")).toBe("relight_other");
  store.useToken("relight_third", false);
  expect(sessionStorage.getItem("relight-token")).toBe("relight_third");
  expect(localStorage.getItem("relight-token")).toBeNull();
});

test("the token of a link that is opened in the same tab is used", () => {
  let used = "";
  store.client.useToken = (token) => (used = token);
  browser.type("#token=relight_guest_new&model=cow");
  expect(used).toBe("relight_guest_new");
  expect(sessionStorage.getItem("relight-token")).toBe("relight_guest_new");
  expect(browser.entries.map(({ url }) => url).join(" ")).not.toContain("guest_new");
  expect(store.scene.value.model).toBe("cow");
});

test("a page whose browser keeps nothing starts all the same", async () => {
  const refuse = () => {
    throw new DOMException("access is denied", "SecurityError");
  };
  const storage = { getItem: refuse, setItem: refuse, removeItem: refuse };
  vi.stubGlobal("localStorage", storage);
  vi.stubGlobal("sessionStorage", storage);
  vi.resetModules();
  const again = await import("../src/ui/store");
  const here = await import("../src/room/here");
  again.client.connect = () => undefined;
  again.useToken("relight_fourth", true);
  here.setName("Ann");
  expect(here.myName.value).toBe("Ann");
});

test("what another version kept about rooms does not stop the page", async () => {
  vi.stubGlobal("localStorage", { getItem: () => "{", setItem: () => undefined });
  vi.resetModules();
  expect((await import("../src/room/here")).readBefore.value).toBe(0);
});
