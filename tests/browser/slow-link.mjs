// SPDX-License-Identifier: MIT
// A link that is long and thin, between browser and daemon: a token bucket each way, and a delay.
import { createServer, connect } from "node:net";

/** rate: bytes a second each way; delayMs: one way. Both may be changed while it runs. */
export class SlowLink {
  constructor(port, rate, delayMs) {
    this.rate = rate;
    this.delayMs = delayMs;
    this.sockets = new Set();
    this.server = createServer((near) => {
      const far = connect(port, "127.0.0.1");
      this.carry(near, far);
      this.carry(far, near);
    });
  }

  async listen() {
    await new Promise((resolve) => this.server.listen(0, "127.0.0.1", resolve));
    return this.server.address().port;
  }

  carry(from, to) {
    let free = 0; // when the last byte that was taken has left
    this.sockets.add(from);
    from.setNoDelay(true);
    from.on("data", (bytes) => {
      const now = Date.now();
      free = Math.max(free, now) + (1000 * bytes.length) / this.rate;
      // What has not left is not read further: a bucket of one segment.
      from.pause();
      setTimeout(() => from.resume(), free - now);
      setTimeout(() => to.writable && to.write(bytes), free - now + this.delayMs);
    });
    const end = () => {
      this.sockets.delete(from);
      setTimeout(() => to.destroy(), this.delayMs);
    };
    from.on("close", end);
    from.on("error", () => from.destroy());
  }

  close() {
    for (const socket of this.sockets) socket.destroy();
    this.server.close();
  }
}

/** Notes each frame of the page's view: states that are outstanding, delay, rows of a cluster. */
export const noteFrames = (page) =>
  page.evaluate(() => {
    const { view } = globalThis.relightViewer;
    const received = view.received.bind(view);
    globalThis.frames = [];
    view.received = (frame, payload) => {
      const { outstanding } = view;
      const own = outstanding.find(({ sequence }) => sequence === frame.sequence);
      globalThis.frames.push({
        atMs: performance.now(),
        delayMs: own ? performance.now() - own.atMs : 0,
        waits: view.waits,
        rows: frame.colors?.coefficients?.mostRank ?? 0,
        coarse: frame.colors?.nCoarse ?? 0,
        bytes: payload.length,
        daemonMs: (frame.colors ?? frame.image)?.cost?.totalMs ?? 0,
      });
      received(frame, payload);
    };
  });

// The page itself moves the mouse that is down. A hand that comes through the browser's protocol waits
// for an answer to each move: on a busy machine for longer than a frame takes, and then no two states
// overlap.
const moveByItself = (page) =>
  page.evaluate(() => {
    let n = 0;
    globalThis.hand = setInterval(
      () =>
        document.querySelector(".stage").dispatchEvent(
          new PointerEvent("pointermove", {
            pointerId: 1, // the mouse
            clientX: 150 + (n++ % 120),
            clientY: 150,
            buttons: 1,
            shiftKey: true,
            bubbles: true,
          }),
        ),
      8,
    );
  });

/** Turns the light by a drag until `enough` holds of the frames, which are returned; for two minutes
 * at most. It is asked every everyMs: the question takes the page's time. noteFrames() comes first. */
export async function turnUntil(page, enough, everyMs = 50) {
  const seen = await page.evaluate(() => globalThis.frames.length);
  await page.keyboard.down("Shift");
  await page.mouse.move(150, 150);
  await page.mouse.down();
  await moveByItself(page);
  const end = Date.now() + 120_000;
  let frames = [];
  while (Date.now() < end && !enough(frames)) {
    await page.waitForTimeout(everyMs);
    frames = await page.evaluate((n) => globalThis.frames.slice(n), seen);
  }
  await page.evaluate(() => clearInterval(globalThis.hand));
  await page.mouse.up();
  await page.keyboard.up("Shift");
  return frames;
}
