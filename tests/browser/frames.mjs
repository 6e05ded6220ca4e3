// SPDX-License-Identifier: MIT
// How fast the page follows a hand that turns the light: frames that the GPU finished (fences) and the
// time from a state of the hand to its picture, page and daemon on one machine.
//
//   node frames.mjs FOLDER_OF_THE_PROGRAMS FOLDER_OF_CLIENT_WEB MODEL.prt [WIDTHxHEIGHT [SECONDS]]
//
// prints one JSON object. It measures, and fails by no speed.
import { spawn } from "node:child_process";
import { copyFileSync, existsSync, mkdirSync, mkdtempSync, rmSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join, resolve as absolute } from "node:path";
import { noteFrames, turnUntil } from "./slow-link.mjs";

const [bin, web, model, size = "800x600", seconds = "10"] = process.argv.slice(2);
if (!model) {
  console.error("usage: frames.mjs PROGRAMS WEB MODEL.prt [WIDTHxHEIGHT [SECONDS]]");
  process.exit(1);
}
const [width, height] = size.split("x").map(Number);
const { chromium } = createRequire(absolute(web, "package.json"))("playwright-core");
const executablePath = ["chromium-headless-shell", "chromium"]
  .map((name) => `/usr/bin/${name}`)
  .find(existsSync);
const folder = mkdtempSync(join(tmpdir(), "relight-frames-"));
mkdirSync(join(folder, "models"));
copyFileSync(model, join(folder, "models", "model.prt"));

const daemon = spawn(
  join(bin, "relightd"),
  ["--models", join(folder, "models"), "--data", join(folder, "data")].concat(
    ["--page", join(bin, "../share/relight/page"), "--http", "127.0.0.1:0"],
    ["--listen", `unix:${join(folder, "socket")}`, "--preview-walks=no"],
  ),
  { stdio: ["ignore", "ignore", "pipe"] },
);
const port = await new Promise((resolve, reject) => {
  let log = "";
  daemon.stderr.on("data", (text) => {
    log += String(text);
    const found = /listen address=http:127\.0\.0\.1:(\d+)/.exec(log);
    if (found) resolve(found[1]);
  });
  daemon.on("exit", () => reject(new Error(`relightd ended: ${log}`)));
});

/** Of each picture: milliseconds from the hand's state to the end of the frame on the GPU, looked for
 * at each animation frame. */
const notePictures = (page) =>
  page.evaluate(() => {
    const { stage } = globalThis.relightViewer;
    const { frames } = globalThis;
    const { onBegun } = stage;
    let [begun, shown] = [frames.length, frames.length]; // answers that are being drawn, were drawn
    let { finished } = stage;
    stage.onBegun = () => {
      onBegun?.();
      begun = frames.length;
    };
    globalThis.pictures = [];
    const look = () => {
      if (stage.finished !== finished && begun > shown) {
        const { atMs, delayMs } = frames[begun - 1];
        globalThis.pictures.push(delayMs + performance.now() - atMs);
        shown = begun;
      }
      finished = stage.finished;
      requestAnimationFrame(look);
    };
    look();
  });

const middle = (values) => [...values].sort((a, b) => a - b)[values.length >> 1] ?? NaN;
const browser = await chromium.launch({
  executablePath,
  args: [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
  ],
});
try {
  const page = await browser.newPage({ viewport: { width, height } });
  await page.goto(`http://127.0.0.1:${port}/#model=model.prt&light=page:window@0,0`);
  const patience = { timeout: 120_000 };
  await page.waitForFunction(
    () => globalThis.relightViewer?.status.mode === "mesh" && globalThis.relightViewer.settled,
    null,
    patience,
  );
  await noteFrames(page);
  await notePictures(page);
  const finished = () => page.evaluate(() => globalThis.relightViewer.stage.finished);
  await turnUntil(page, (frames) => frames.length > 20); // warm
  const [before, startMs] = [await finished(), performance.now()];
  await page.evaluate(() => (globalThis.pictures.length = 0));
  const frames = await turnUntil(
    page,
    () => performance.now() - startMs > 1000 * Number(seconds),
    1000,
  );
  const took = (performance.now() - startMs) / 1000;
  const canvas = await page.evaluate(() => {
    const { width, height } = globalThis.relightViewer.stage.canvas;
    return { width, height, stream: globalThis.relightViewer.status.stream };
  });
  console.log(
    JSON.stringify({
      page: size,
      canvas: `${canvas.width}x${canvas.height}`,
      stream: canvas.stream,
      frames_per_s: Number((((await finished()) - before) / took).toFixed(1)),
      answers_per_s: Number((frames.length / took).toFixed(1)),
      answer_ms_median: Number(middle(frames.map(({ delayMs }) => delayMs)).toFixed(1)),
      daemon_ms_median: Number(middle(frames.map(({ daemonMs }) => daemonMs)).toFixed(1)),
      picture_ms_median: Number(
        middle(await page.evaluate(() => globalThis.pictures)).toFixed(1),
      ),
      states_waiting_most: Math.max(...frames.map(({ waits }) => waits)),
      bytes: frames.at(-1)?.bytes,
    }),
  );
} finally {
  await browser.close();
  daemon.removeAllListeners("exit");
  daemon.kill("SIGTERM");
  rmSync(folder, { recursive: true, force: true });
}
