// SPDX-License-Identifier: MIT
// A daemon whose models replicas share: the page names its model in the path of its WebSocket, by
// which a proxy chooses. For page.mjs.
import assert from "node:assert/strict";
import { join } from "node:path";

/** tools: open, mode, start, stop, folder, PATIENCE of page.mjs; daemon(): its process. */
export function replicaScenarios({ open, mode, start, stop, daemon, folder, PATIENCE }) {
  return {
    async "an element names its model, and leaves a daemon that is about to stop"(home, port) {
      await stop();
      await start(port, ["--store", join(folder, "shared"), "--lame-duck", "120"]);
      try {
        const page = await open("about:blank");
        const seen = [];
        page.on("websocket", (socket) => seen.push(new URL(socket.url()).pathname));
        await page.goto(`${home}/relight-viewer.js`); // any page of this origin
        await page.evaluate(async () => {
          await import("/relight-viewer.js");
          const one = document.createElement("relight-viewer");
          one.setAttribute("model", "marble.prt");
          document.body.replaceChildren(one);
        });
        const drawn = (name) =>
          page.waitForFunction(
            (model) => {
              const one = document.querySelector("relight-viewer");
              return one?.info?.name === model && one.viewer?.status.mode === "mesh";
            },
            name,
            PATIENCE,
          );
        await drawn("marble.prt");
        assert.deepEqual(seen, ["/ws", "/ws/marble.prt"]);
        await page.evaluate(() =>
          document.querySelector("relight-viewer").setAttribute("model", "open.prt"),
        );
        await drawn("open.prt");
        assert.deepEqual(seen.slice(2), ["/ws/open.prt"]);
        // GOAWAY: it connects anew while the daemon still serves, and draws again.
        const again = page.waitForEvent("websocket", PATIENCE);
        daemon().kill("SIGTERM");
        assert.equal(new URL((await again).url()).pathname, "/ws/open.prt");
        await page.waitForFunction(
          () => document.querySelector("relight-viewer").client.hello !== null,
          null,
          PATIENCE,
        );
        assert.equal(daemon().exitCode, null, "the daemon has ended already");
        await drawn("open.prt");
        await page.context().close();
      } finally {
        daemon()?.kill("SIGKILL");
        await stop();
        await start(port);
      }
    },
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
