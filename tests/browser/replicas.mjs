// SPDX-License-Identifier: MIT
// A daemon whose models replicas share: the page names its model in the path of its WebSocket, by
// which a proxy chooses. For page.mjs.
import assert from "node:assert/strict";
import { join } from "node:path";

/** tools: open, mode, start, stop, folder, PATIENCE of page.mjs. */
export function replicaScenarios({ open, mode, start, stop, folder, PATIENCE }) {
  return {
    async "the path names the model where replicas share it"(home, port) {
      const sockets = (page) => {
        const seen = [];
        page.on("websocket", (socket) => seen.push(new URL(socket.url()).pathname));
        return seen;
      };
      const one = await open("about:blank");
      const plain = sockets(one);
      await one.goto(`${home}/#model=marble.prt`);
      await mode(one, "mesh");
      assert.deepEqual(plain, ["/ws"]);
      await one.context().close();
      await stop();
      await start(port, ["--store", join(folder, "shared")]);
      try {
        const page = await open("about:blank");
        const seen = sockets(page);
        await page.goto(`${home}/#model=marble.prt`);
        await mode(page, "mesh");
        assert.deepEqual(seen, ["/ws", "/ws/marble.prt"]);
        await page.evaluate(() => (location.hash = "model=open.prt"));
        await page.waitForFunction(
          () =>
            globalThis.relightViewer.info?.name === "open.prt" &&
            globalThis.relightViewer.status.mode === "mesh",
          null,
          PATIENCE,
        );
        assert.deepEqual(seen.slice(2), ["/ws/open.prt"]);
        await page.context().close();
      } finally {
        await stop();
        await start(port);
      }
    },
  };
}
