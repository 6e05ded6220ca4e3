// SPDX-License-Identifier: MIT
// People in review rooms: each has a browser of their own. For the scenarios of rooms.mjs, review.mjs
// and own-scene.mjs.

const settings = {
  storageState: undefined,
  viewport: { width: 1100, height: 700 },
  permissions: ["clipboard-read", "clipboard-write"],
};

/** The room that the page's address names. */
export const roomOf = (page) => /room=([0-9a-f]{32})/.exec(page.url())[1];

/** Pins `text` where the mouse clicks; returns when the button was pressed [ms]. */
export async function placePin(page, text, at) {
  await page.locator(".stage").focus();
  await page.keyboard.press("p");
  await page.mouse.click(...at);
  await page.getByLabel("What is wrong here").fill(text);
  const begin = Date.now();
  await page.getByRole("button", { name: "Place the pin" }).click();
  return begin;
}

/** tools: open, mode, PATIENCE of page.mjs. */
export function people({ open, mode, PATIENCE }) {
  const enter = async (url, name) => {
    const page = await open("about:blank", settings);
    await page.addInitScript(`localStorage.setItem("relight-name", ${JSON.stringify(name)});`);
    await page.goto(url);
    return page;
  };
  const inRoom = (page) => page.locator(".room-bar").waitFor(PATIENCE);
  return {
    /** A page of a person of this name. */
    enter,
    inRoom,
    /** That person draws what the address's words say and makes a room of it. */
    async create(home, words, name, title, drawn = "mesh") {
      const page = await enter(`${home}/#${words}`, name);
      await mode(page, drawn);
      await page.getByRole("button", { name: /^Rooms/ }).click();
      await page.getByLabel("A new room about this picture").fill(title);
      await page.getByRole("button", { name: "Create the room" }).click();
      await inRoom(page);
      return page;
    },
    /** Another person in the room of that page. */
    async join(page, name) {
      const other = await enter(page.url().replace(/#.*/, ""), name);
      await inRoom(other);
      await mode(other, "mesh");
      return other;
    },
    /** Until all that the page sent is answered and its hand rests. */
    rests: (page) => page.waitForFunction(() => globalThis.relightRoom.rests(), null, PATIENCE),
    /** Until the focus is on the button of that name: what was closed gives it back. */
    focusIsOn: (page, name) =>
      page.waitForFunction(
        (words) => document.activeElement?.textContent === words,
        name,
        PATIENCE,
      ),
    /** Pins, and waits until the page lists it. */
    async pin(page, text, at) {
      await placePin(page, text, at);
      await page.locator(".pin-row", { hasText: text }).waitFor(PATIENCE);
    },
  };
}
