// SPDX-License-Identifier: MIT
// The token of a link is a secret: it goes out of the address before anything else reads that.
import { expect, test } from "vitest";
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
