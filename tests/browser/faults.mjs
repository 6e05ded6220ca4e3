// SPDX-License-Identifier: MIT
// What the page does where the browser lacks something or the daemon refuses. For page.mjs.
import assert from "node:assert/strict";

/** tools: open, mode, settled, shot, folder, PATIENCE of page.mjs. */
export function faultScenarios({ open, mode, shot, PATIENCE }) {
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
  };
}
