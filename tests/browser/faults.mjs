// SPDX-License-Identifier: MIT
// What the page does where the browser lacks something or the daemon refuses. For page.mjs.
import { writeFileSync } from "node:fs";
import { join } from "node:path";
import assert from "node:assert/strict";
import { people, placePin } from "./people.mjs";
import { png } from "./toy.mjs";

// Requests of this type are refused until that is ended.
const refuse = (page, type) =>
  page.evaluate((one) => {
    const { client } = globalThis.relightViewer;
    const real = client.request;
    client.request = (...words) =>
      words[0] === one
        ? Promise.reject(new Error("the daemon refused it"))
        : real.apply(client, words);
  }, type);
const permit = (page) => page.evaluate(() => delete globalThis.relightViewer.client.request);
const ROOM_EDIT = 31;
const ROOM_PICTURE = 32;

/** tools: open, mode, shot, folder, PATIENCE of page.mjs. */
export function faultScenarios({ open, mode, shot, folder, PATIENCE }) {
  const { create, pin, rests } = people({ open, mode, PATIENCE });
  return {
    async "a link is copied without a clipboard, or shown"(home) {
      const page = await open("about:blank", {
        permissions: ["clipboard-read", "clipboard-write"],
      });
      await page.goto(`${home}/#model=marble.prt`);
      await mode(page, "mesh");
      // As on plain http: the browser has a clipboard on the loopback address.
      await page.evaluate(() => {
        globalThis.realClipboard = navigator.clipboard;
        Object.defineProperty(navigator, "clipboard", { value: undefined });
      });
      await page.getByRole("button", { name: /Copy a link/ }).click();
      await page.locator(".toast").waitFor(PATIENCE);
      assert.equal(
        await page.evaluate(() => globalThis.realClipboard.readText()),
        page.url(),
        "the link is in the clipboard",
      );
      await page.evaluate(() => (document.execCommand = () => false));
      await page.getByRole("button", { name: /Copy a link|The link is copied/ }).click();
      const field = page.getByLabel("Link to copy");
      await field.waitFor(PATIENCE);
      assert.equal(await field.inputValue(), page.url());
      assert.equal(
        await field.evaluate((one) => one.selectionEnd - one.selectionStart),
        page.url().length,
      );
      await shot(page, "link-to-copy");
      await page.getByRole("button", { name: "Close this link" }).click();
      await field.waitFor({ ...PATIENCE, state: "detached" });
      await page.context().close();
    },

    async "a reply and a pin that are refused keep their text"(home) {
      const ann = await create(home, "model=marble.prt&light=constant@0,0", "Ann", "Refused");
      await pin(ann, "a dent", [340, 330]);
      await rests(ann);
      await refuse(ann, ROOM_EDIT);
      const reply = ann.getByLabel("Reply", { exact: true });
      await reply.fill("a longer thought");
      await ann.getByRole("button", { name: "Reply", exact: true }).click();
      await ann.getByText("the daemon refused it").waitFor(PATIENCE);
      assert.equal(await reply.inputValue(), "a longer thought");
      await ann.getByRole("button", { name: "Close this message" }).click();
      await placePin(ann, "another dent", [330, 350]);
      await ann.getByText("the daemon refused it").waitFor(PATIENCE);
      const text = ann.getByLabel("What is wrong here");
      assert.equal(await text.inputValue(), "another dent");
      await permit(ann);
      await ann.getByRole("button", { name: "Place the pin" }).click();
      await text.waitFor({ ...PATIENCE, state: "detached" });
      await ann.locator(".pin-row", { hasText: "another dent" }).waitFor(PATIENCE);
      await ann.locator(".pin-title", { hasText: "a dent" }).click();
      assert.equal(await reply.inputValue(), "a longer thought");
      await ann.getByRole("button", { name: "Reply", exact: true }).click();
      await ann.locator(".thread li").getByText("a longer thought").waitFor(PATIENCE);
      assert.equal(await reply.inputValue(), "");
      await ann.context().close();
    },

    async "a decision is about the picture that was drawn again"(home) {
      const ann = await create(home, "model=marble.prt&light=constant@0,0", "Ann", "Again");
      await rests(ann);
      await refuse(ann, ROOM_PICTURE);
      await ann.getByRole("button", { name: "Approve", exact: true }).click();
      await ann.getByText("This cannot be drawn").waitFor(PATIENCE);
      await permit(ann);
      await ann.evaluate(() => globalThis.relightViewer.client.reconnect());
      await ann.getByAltText("What the decision is about").waitFor(PATIENCE);
      await ann.getByRole("button", { name: "Approve this picture" }).click();
      await ann.getByText("approved as it is now").waitFor(PATIENCE);
      await ann.context().close();
    },

    async "a picture comes back after the browser took the GPU away"(home) {
      const page = await open(`${home}/#model=marble.prt&light=constant@0,0`);
      await mode(page, "mesh");
      const settled = () =>
        page.waitForFunction(() => globalThis.relightViewer.settled, null, PATIENCE);
      const sum = () =>
        page.evaluate(() => {
          const bytes = globalThis.relightViewer.stage.readEncoded(64, 64);
          return bytes.reduce((all, byte) => all + byte, 0);
        });
      await page.waitForFunction(
        () => globalThis.relightViewer.status.stream === "coefficients",
        null,
        PATIENCE,
      );
      await settled();
      const before = await sum();
      const frames = await page.evaluate(() => globalThis.relightViewer.status.frames);
      await page.evaluate(async () => {
        const gl = globalThis.relightViewer.stage.renderer.getContext();
        const lose = gl.getExtension("WEBGL_lose_context");
        const { canvas } = globalThis.relightViewer;
        const restored = new Promise((done) =>
          canvas.addEventListener("webglcontextrestored", done),
        );
        canvas.addEventListener("webglcontextlost", () =>
          setTimeout(() => lose.restoreContext(), 50),
        );
        lose.loseContext();
        await restored;
      });
      await page.waitForFunction(
        (n) => globalThis.relightViewer.status.frames > n,
        frames,
        PATIENCE,
      );
      await settled();
      const after = await sum();
      assert.ok(Math.abs(after - before) < 0.01 * before, `${after} of ${before}`);
      await page.context().close();
    },

    async "the same file is chosen twice"(home) {
      const page = await open(`${home}/#model=marble.prt`);
      await mode(page, "mesh");
      const sky = join(folder, "sky.png");
      writeFileSync(
        sky,
        png(16, (u, v) => [v, v, 1]),
      );
      const input = page.locator(".gallery input[type=file]");
      for (let i = 0; i < 2; i++) {
        await page.getByRole("radio", { name: "Even" }).click();
        await page.waitForFunction(
          () => globalThis.relightViewer.state.lamps[0].env === "constant",
        );
        await input.setInputFiles(sky);
        await page.waitForFunction(
          () => globalThis.relightViewer.state.lamps[0].env.startsWith("env:"),
          null,
          PATIENCE,
        );
        // A browser tells of a choice where the value changes.
        assert.equal(await input.inputValue(), "");
      }
      await page.context().close();
    },

    async "a message about a file stays while frames come"(home) {
      const page = await open(`${home}/#model=marble.prt&light=constant@0,0`);
      await mode(page, "mesh");
      const words = join(folder, "words.txt");
      writeFileSync(words, "no model");
      await page.locator(".gallery input[type=file]").setInputFiles(words);
      const message = page.getByText(/words\.txt is no model/);
      await message.waitFor(PATIENCE);
      const frames = await page.evaluate(() => globalThis.relightViewer.status.frames);
      await page.locator(".stage").focus();
      await page.keyboard.press("Shift+ArrowRight");
      await page.waitForFunction(
        (n) => globalThis.relightViewer.status.frames > n,
        frames,
        PATIENCE,
      );
      await page.waitForTimeout(200);
      assert.ok(await message.isVisible());
      // Files are dropped on the page; words that are dragged go into its fields.
      const taken = await page.evaluate(() => {
        const drag = (fill) => {
          const dataTransfer = new DataTransfer();
          fill(dataTransfer.items);
          const event = new DragEvent("dragover", {
            dataTransfer,
            bubbles: true,
            cancelable: true,
          });
          document.body.dispatchEvent(event);
          return event.defaultPrevented;
        };
        return [
          drag((items) => items.add("words", "text/plain")),
          drag((items) => items.add(new File(["v"], "a.obj"))),
        ];
      });
      assert.deepEqual(taken, [false, true]);
      await page.getByText("Drop a model or a light").waitFor(PATIENCE);
      await page.context().close();
    },
  };
}
