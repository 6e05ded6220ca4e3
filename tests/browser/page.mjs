// SPDX-License-Identifier: MIT
// The real page in Debian's Chromium against a real relightd: one scenario after another, each
// with its own assertions. Arguments: the folder of the programs, the folder of client/web, and
// optionally a folder for screenshots. Exits with 77 where there is no Chromium. Above 600 lines:
// a list of scenarios, each read alone.
import { spawn, spawnSync } from "node:child_process";
import { createServer } from "node:http";
import {
  existsSync,
  mkdirSync,
  mkdtempSync,
  readFileSync,
  rmSync,
  writeFileSync,
} from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import assert from "node:assert/strict";
import { faultScenarios } from "./faults.mjs";
import { ownScenarios } from "./own-scene.mjs";
import { replicaScenarios } from "./replicas.mjs";
import { reviewScenarios } from "./review.mjs";
import { roomScenarios } from "./rooms.mjs";
import { noteFrames, SlowLink, turnUntil } from "./slow-link.mjs";
import { streamScenarios } from "./streams.mjs";
import { toy } from "./toy.mjs";

const [bin, web, shots] = process.argv.slice(2);
const require = createRequire(join(web, "package.json"));
const { chromium } = require("playwright-core");
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");

const browserPath = ["chromium-headless-shell", "chromium"]
  .map((name) => `/usr/bin/${name}`)
  .find(existsSync);
if (!browserPath) {
  console.log("SKIPPED: no chromium here (deploy/dependencies --tests)");
  process.exit(77);
}
const folder = mkdtempSync(join(tmpdir(), "relight-browser-"));
const PATIENCE = { timeout: Number(process.env.PATIENCE_MS ?? 240_000) }; // how long a busy machine may take; nothing fails by speed

// ---- a model, a daemon

// A sphere with bumps of 642 vertices: small enough to bake in seconds, with shadowed valleys.
function bumpySphere() {
  const n = 24;
  const lines = [];
  for (let i = 0; i <= n; i++)
    for (let k = 0; k <= n; k++) {
      const a = (Math.PI * i) / n;
      const b = (2 * Math.PI * (k % n)) / n; // the seam's two sides are equal: it is closed
      const across = i % n ? Math.sin(a) : 0;
      const r = 1 + 0.22 * Math.sin(3 * b) * across ** 3 + 0.12 * Math.cos(4 * a);
      lines.push(
        `v ${r * across * Math.cos(b)} ${r * Math.cos(a)} ${-r * across * Math.sin(b)}`,
      );
    }
  for (let i = 0; i < n; i++)
    for (let k = 0; k < n; k++) {
      const at = i * (n + 1) + k + 1;
      lines.push(`f ${at} ${at + n + 1} ${at + n + 2}`, `f ${at} ${at + n + 2} ${at + 1}`);
    }
  return `${lines.join("\n")}\n`;
}

// The side of +x, where it is farther than 0.4, is pressed in.
function shorter(line) {
  const [x, y, z] = line.split(" ").slice(1).map(Number);
  return `v ${x > 0.4 ? 0.4 + 0.3 * (x - 0.4) : x} ${y} ${z}`;
}

function bake() {
  mkdirSync(join(folder, "models"));
  writeFileSync(join(folder, "bumps.obj"), bumpySphere());
  writeFileSync(join(folder, "toy.glb"), toy());
  const write = 'import variant_model; variant_model.write("variants.glb")';
  const units = join(import.meta.dirname, "../unit");
  const env = { ...process.env, PYTHONPATH: units, PYTHONDONTWRITEBYTECODE: "1" };
  const written = spawnSync("/usr/bin/python3", ["-c", write], { cwd: folder, env });
  assert.equal(written.status, 0, String(written.stderr));
  // Another model of nearly the same surface: pins of the first find their place by position.
  writeFileSync(join(folder, "shorter.obj"), bumpySphere().replace(/^v .*$/gm, shorter));
  const thin = join(folder, "thin.json"); // a medium whose single scattering is much of its light
  writeFileSync(thin, '{"sigma_s_prime":[0.5,0.5,0.5],"sigma_a":[0.02,0.05,0.1],"eta":1.3}');
  const common = ["--size-mm", "20", "--cube", "16", "--samples", "6000"];
  for (const [name, file, extra] of [
    ["marble", "bumps.obj", ["--material", "marble"]],
    ["open", "bumps.obj", []],
    [
      "toy",
      "toy.glb",
      ["--transport", "joint", "--material", "Left=skin2", "--material", "skin1"],
    ],
    ["shorter", "shorter.obj", ["--material", "wholemilk"]],
    ["thin", "bumps.obj", ["--material", thin, "--exit-planes"]],
    ["thin-open", "bumps.obj", ["--exit-planes"]],
    ["variants", "variants.glb", []],
    ["any", "bumps.obj", ["--any-eta", "--no-single"]],
  ]) {
    const out = join(folder, "models", `${name}.prt`);
    const done = spawnSync(join(bin, "prt"), [
      "bake",
      join(folder, file),
      ...common,
      ...extra,
      "-o",
      out,
    ]);
    assert.equal(done.status, 0, String(done.stderr));
  }
}

// Bakes that the daemon orders are as small as those above.
function smallBaker() {
  const path = join(folder, "prt");
  const more = "--samples 6000 --cube 16";
  const lines = [
    "#!/bin/sh",
    `[ "$1" != bake ] || set -- "$@" ${more}`,
    `exec "${join(bin, "prt")}" "$@"`,
  ];
  writeFileSync(path, `${lines.join("\n")}\n`, { mode: 0o755 });
  return path;
}

let daemon = null;
// On a free port at first, on the same one after a restart.
async function start(port = 0, options = []) {
  const log = [];
  daemon = spawn(
    join(bin, "relightd"),
    [
      "--models",
      join(folder, "models"),
      "--data",
      join(folder, "data"),
      "--preview-walks=no",
      "--prt",
      smallBaker(),
      "--page",
      join(bin, "../share/relight/page"),
    ]
      .concat(["--http", `127.0.0.1:${port}`, "--listen", `unix:${join(folder, "socket")}`])
      .concat(options),
    { stdio: ["ignore", "ignore", "pipe"] },
  );
  return new Promise((resolve, reject) => {
    daemon.stderr.on("data", (text) => {
      log.push(String(text));
      const found = /listen address=http:127\.0\.0\.1:(\d+)/.exec(log.join(""));
      if (found) resolve(Number(found[1]));
    });
    daemon.on("exit", (status) =>
      reject(new Error(`relightd ended with ${status}: ${log.join("")}`)),
    );
  });
}
async function stop() {
  const old = daemon;
  daemon = null;
  if (!old) return;
  const ended = new Promise((resolve) => old.on("exit", resolve));
  old.kill("SIGTERM");
  await ended;
}

// The events of a room, as the terminal's client reads them.
function roomLog(room) {
  const read = spawnSync(
    join(bin, "relight"),
    ["-s", `unix:${join(folder, "socket")}`, "room", "log", room, "--json"],
    { maxBuffer: 1 << 26 },
  );
  assert.equal(read.status, 0, String(read.stderr));
  return String(read.stdout)
    .split("\n")
    .filter(Boolean)
    .map((line) => JSON.parse(line));
}

// ---- the browser

let browser;
const faults = [];
async function open(url, options = {}) {
  const context = await browser.newContext({
    viewport: { width: 640, height: 420 },
    ...options,
  });
  const page = await context.newPage();
  page.on("pageerror", (error) => faults.push(`${url}: ${error.message}`));
  page.on("console", (message) => {
    // A lost or refused connection is reported by the browser itself.
    if (
      message.type() === "error" &&
      !/WebSocket|ERR_|Failed to load resource/.test(message.text())
    )
      faults.push(`${url}: ${message.text()}`);
  });
  await page.goto(url);
  return page;
}
const mode = (page, wanted) =>
  page.waitForFunction(
    (one) => globalThis.relightViewer?.status.mode === one,
    wanted,
    PATIENCE,
  );
const coefficients = async (page) => {
  await page.waitForFunction(
    () => globalThis.relightViewer.status.stream === "coefficients",
    null,
    PATIENCE,
  );
  await settled(page);
};
// The newest state was drawn in full: no frame and no map is awaited, the GPU is idle.
async function settled(page) {
  await page.waitForFunction(() => globalThis.relightViewer.settled, null, PATIENCE);
  await page.waitForTimeout(100);
}
const linear = (page, width = 160, height = 120) =>
  page.evaluate(
    ([w, h]) => Array.from(globalThis.relightViewer.stage.readLinear(w, h)),
    [width, height],
  );
function difference(a, b) {
  let sum = 0;
  let power = 0;
  for (let i = 0; i < a.length; i++) {
    if (i % 4 === 3) continue;
    sum += (a[i] - b[i]) ** 2;
    power += b[i] ** 2;
  }
  return Math.sqrt(sum / power);
}
/** The mean height of what a map of ΔE shows and of what differs between the pictures, in heights of
 * the map from its top. */
const heights = (page) =>
  page.evaluate(() => {
    const canvas = document.querySelector("canvas.map");
    const { width, height } = canvas;
    const map = canvas.getContext("2d").getImageData(0, 0, width, height).data;
    const [a, b] = [globalThis.relightViewer, globalThis.relightOther].map(({ stage }) =>
      stage.readEncoded(width, height),
    );
    const mean = (weight) => {
      let [sum, all] = [0, 0];
      for (let i = 0; i < width * height; i++) {
        const w = weight(i);
        sum += (w * (Math.floor(i / width) + 0.5)) / height;
        all += w;
      }
      return sum / all;
    };
    const differs = (i) => Number([0, 1, 2].some((c) => a[4 * i + c] !== b[4 * i + c]));
    // Rows of WebGL begin at the bottom.
    return [mean((i) => map[4 * i]), 1 - mean(differs)];
  });
async function shot(page, name) {
  if (shots) await page.screenshot({ path: join(shots, `${name}.png`) });
}
async function drag(page, from, by, key) {
  if (key) await page.keyboard.down(key);
  await page.mouse.move(...from);
  await page.mouse.down();
  await page.mouse.move(from[0] + by[0] / 2, from[1] + by[1] / 2);
  await page.mouse.move(from[0] + by[0], from[1] + by[1]);
  await page.mouse.up();
  if (key) await page.keyboard.up(key);
}

// Relative RMSE in linear light between what the page draws and the daemon's picture of the same
// state, without pixels near an edge of the shape, where the two sample coverage differently. Both
// compute 3 x 3 points a pixel, so that the point of a pixel that is shaded matters little.
const againstDaemon = (page) =>
  page.evaluate(async () => {
    const v = globalThis.relightViewer;
    const [w, h] = [v.canvas.clientWidth, v.canvas.clientHeight];
    const drawn = v.stage.readLinear(w, h);
    const fine = 3;
    const still = await v.still(5 /* IMAGE_F16 */, {
      width: fine * w,
      height: fine * h,
    });
    const bits = new Uint16Array(still.bytes.slice().buffer);
    const half = (x) => {
      const e = (x >> 10) & 31;
      const m = x & 1023;
      return (x >> 15 ? -1 : 1) * (e ? 2 ** (e - 15) * (1 + m / 1024) : m * 2 ** -24);
    };
    const theirs = new Float32Array(3 * w * h);
    for (let i = 0; i < bits.length; i++) {
      const x = Math.floor(i / 3) % (fine * w);
      const y = Math.floor(i / 3 / (fine * w));
      const to = 3 * (Math.floor(y / fine) * w + Math.floor(x / fine)) + (i % 3);
      theirs[to] += half(bits[i]) / fine ** 2;
    }
    const at = (x, y, c) => theirs[3 * (y * w + x) + c];
    const mine = (x, y, c) => drawn[4 * ((h - 1 - y) * w + x) + c];
    const plain = [0, 1, 2].map((c) => at(0, 0, c));
    const inside = (x, y) =>
      [0, 1, 2].some((c) => Math.abs(at(x, y, c) - plain[c]) > 0.004 + 0.01 * plain[c]);
    let sum = 0;
    let power = 0;
    let n = 0;
    for (let y = 2; y < h - 2; y++)
      for (let x = 2; x < w - 2; x++) {
        let whole = true;
        for (let b = -2; b <= 2 && whole; b++)
          for (let a = -2; a <= 2 && whole; a++) whole = inside(x + a, y + b);
        if (!whole) continue;
        n++;
        for (let c = 0; c < 3; c++) {
          sum += (mine(x, y, c) - at(x, y, c)) ** 2;
          power += at(x, y, c) ** 2;
        }
      }
    return { rmse: Math.sqrt(sum / power), pixels: n };
  });

// ---- scenarios

/** How far colours of an error map are from those of its places, where these are seen. */
const farFromPlaces = (page, heat) =>
  page.evaluate((heat) => {
    const { stage, shape, errorPlaces, mostError, dipoleError } = globalThis.relightViewer;
    const places = heat === "error" ? errorPlaces : dipoleError.places;
    const [w, h] = [800, 600];
    const picture = stage.readLinear(w, h);
    const { camera } = stage;
    const m = camera.matrixWorldInverse.elements;
    const p = camera.projectionMatrix.elements;
    const [low, middle, high] = [
      [0.1, 0.06, 0.33],
      [0.13, 0.57, 0.55],
      [0.99, 0.91, 0.14],
    ];
    const mix = (a, b, x) => a.map((v, i) => v + (b[i] - v) * x);
    const ramp = (x) => (x < 0.5 ? mix(low, middle, 2 * x) : mix(middle, high, 2 * x - 1));
    const ratio = (excess) => {
      const t = Math.min(Math.max(Math.log2(Math.max(1 + excess, 0.5)), -1), 1);
      return t > 0 ? [1, 1 - t, 1 - t] : [1 + t, 1 + t, 1];
    };
    const colorOf = (e) => (heat === "error" ? ramp(e / mostError) : ratio(e));
    const turned = (v, at) =>
      [0, 1, 2].map((i) => m[i] * v[0] + m[4 + i] * v[1] + m[8 + i] * v[2] + at * m[12 + i]);
    return places.vertex.flatMap((v, k) => {
      const seen = turned(shape.positions.subarray(3 * v, 3 * v + 3), 1);
      const n = turned(shape.normals.subarray(3 * v, 3 * v + 3), 0);
      const facing =
        -(n[0] * seen[0] + n[1] * seen[1] + n[2] * seen[2]) /
        Math.hypot(...n) /
        Math.hypot(...seen);
      if (facing < 0.4) return [];
      const x = Math.floor(((-p[0] * seen[0]) / seen[2] / 2 + 0.5) * w);
      const y = Math.floor(((-p[5] * seen[1]) / seen[2] / 2 + 0.5) * h);
      const want = colorOf(places.error[k]).map((c) => c * (0.55 + 0.45 * facing));
      return [Math.max(...want.map((c, i) => Math.abs(c - picture[4 * (y * w + x) + i])))];
    });
  }, heat);

const scenarios = {
  async "models are shown, one with maps, and their pictures are those of the daemon"(home) {
    for (const [model, more] of [
      ["marble.prt", ""],
      ["toy.prt", ""],
      ["toy.prt", "&term=multiple"],
    ]) {
      const page = await open(`${home}/#model=${model}&light=page:window@40,0${more}`);
      await mode(page, "mesh");
      await coefficients(page);
      const { rmse, pixels } = await againstDaemon(page);
      console.log(
        `  ${model}${more} against the daemon's picture: ` +
          `${(100 * rmse).toFixed(2)} % of ${pixels} pixels`,
      );
      assert.ok(pixels > 5000);
      assert.ok(rmse < 0.02, `relative RMSE ${rmse}`);
      await shot(page, more ? "maps-multiple" : model.replace(".prt", ""));
      await page.context().close();
    }
  },

  async "colours and coefficients give the same picture, that of the daemon"(home) {
    const dense = '{"sigma_s_prime":[2,2.5,3],"sigma_a":[0.03,0.05,0.1],"g":0.4}';
    for (const [model, term, material, stream] of [
      ["marble.prt", "multiple", "", "colours, RGB9E5"],
      ["marble.prt", "total", "", "colours, RGB9E5"],
      ["open.prt", "single", "", "colours, RGB9E5"],
      ["open.prt", "total", dense, "colours, halves"],
    ]) {
      const state = new URLSearchParams({
        model,
        term,
        material,
        light: "page:window@40,0",
      });
      const page = await open(`${home}/#${state}`);
      await mode(page, "mesh");
      await coefficients(page);
      const one = await linear(page);
      await page.evaluate(() => globalThis.relightViewer.useCoefficients(false));
      await page.waitForFunction(
        (wanted) => globalThis.relightViewer.status.stream === wanted,
        stream,
        PATIENCE,
      );
      await settled(page);
      const both = difference(await linear(page), one);
      const { rmse } = await againstDaemon(page);
      console.log(
        `  ${model} ${term}${material && ", g .4"}: colours against coefficients ` +
          `${(100 * both).toFixed(3)} %, against the daemon's picture ${(100 * rmse).toFixed(2)} %`,
      );
      assert.ok(both < 0.002, `relative RMSE ${both}`);
      assert.ok(rmse < 0.02, `relative RMSE ${rmse}`);
      await page.context().close();
    }
  },

  async "hands turn the model and the light; the link holds the picture"(home) {
    const page = await open(`${home}/#model=marble.prt&light=page:rim@0,0`);
    await mode(page, "mesh");
    await settled(page);
    await coefficients(page);
    const first = await linear(page);
    await drag(page, [150, 200], [60, 0]);
    await settled(page);
    const orbited = await linear(page);
    assert.ok(difference(first, orbited) > 0.05);
    const frames = await page.evaluate(() => globalThis.relightViewer.status.frames);
    await drag(page, [150, 200], [90, 0], "Shift");
    await page.waitForFunction(
      (n) => globalThis.relightViewer.status.frames > n,
      frames,
      PATIENCE,
    );
    await settled(page);
    const relit = await linear(page);
    assert.ok(difference(orbited, relit) > 0.05);
    await page.focus(".stage");
    await page.keyboard.press("ArrowRight");
    await settled(page);
    assert.ok(difference(relit, await linear(page)) > 0.005);
    const link = page.url();
    assert.match(link, /light=page:rim@40\.5,0/);
    const now = await linear(page);
    const other = await open(link);
    await mode(other, "mesh");
    await coefficients(other);
    assert.ok(difference(now, await linear(other)) < 1e-3);
    await page.goBack();
    await settled(page);
    assert.ok(difference(relit, await linear(page)) < 1e-3);
    await other.context().close();
    await page.context().close();
  },

  async "readers are told of what rests, and not of each turn"(home) {
    const page = await open(`${home}/#model=marble.prt`);
    await mode(page, "mesh");
    const told = await page.evaluate(async () => {
      const degrees = () => Math.round(globalThis.relightViewer.state.orbit.azimuth);
      let [turns, texts] = [0, 0]; // texts: those that came with a turn
      let turnedAt = 0;
      const observer = new MutationObserver(() => {
        if (performance.now() - turnedAt < 400) texts++;
      });
      const text = document.querySelector("#stage-text");
      observer.observe(text, { characterData: true, childList: true, subtree: true });
      document.querySelector('[aria-label^="Turntable"]').click();
      for (let last = degrees(); turns < 10; ) {
        await new Promise((done) => requestAnimationFrame(done));
        if (degrees() === last) continue;
        turns++;
        last = degrees();
        turnedAt = performance.now();
      }
      document.querySelector('[aria-label^="Turntable"]').click();
      return { turns, texts, last: text.textContent };
    });
    assert.ok(2 * told.texts < told.turns, JSON.stringify(told));
    await page.waitForFunction(
      (last) => document.querySelector("#stage-text").textContent !== last,
      told.last,
      PATIENCE,
    );
    await page.context().close();
  },

  async "a medium is edited, and undone"(home) {
    const page = await open(`${home}/#model=open.prt`);
    await mode(page, "mesh");
    await coefficients(page);
    const before = await linear(page);
    await page.getByRole("tab", { name: "Material" }).click();
    await page.getByRole("radio", { name: "Ketchup" }).click();
    await settled(page);
    assert.ok(difference(before, await linear(page)) > 0.1);
    assert.match(page.url(), /material=ketchup/);
    const { rmse } = await againstDaemon(page);
    console.log(`  edited, against the daemon's picture: ${(100 * rmse).toFixed(2)} %`);
    assert.ok(rmse < 0.02, `relative RMSE ${rmse}`);
    await shot(page, "material");
    await page.keyboard.press("Control+z");
    await settled(page);
    assert.ok(difference(before, await linear(page)) < 1e-3);
    await page.context().close();
  },

  async "a bake for any refractive index takes media that another refuses"(home) {
    const page = await open(`${home}/#model=open.prt`);
    await mode(page, "mesh");
    await page.getByRole("tab", { name: "Material" }).click();
    assert.ok(await page.getByRole("radio", { name: "Marble" }).isDisabled());
    await page
      .getByText(/This bake is for the refractive index 1.3: .*Marble/)
      .waitFor(PATIENCE);
    const eta = page.getByLabel("Refractive index η, number");
    assert.equal(await eta.count(), 0);
    await page.evaluate(() => (location.hash = "model=any.prt"));
    await page.waitForFunction(
      () => globalThis.relightViewer.info?.name === "any.prt",
      null,
      PATIENCE,
    );
    await mode(page, "mesh");
    await coefficients(page);
    await page.getByRole("radio", { name: "Marble" }).click();
    await settled(page);
    const marble = await linear(page);
    assert.equal(Number(await eta.inputValue()), 1.5);
    await eta.fill("1.25");
    await eta.press("Enter");
    await settled(page);
    assert.match(decodeURIComponent(page.url()), /"eta":1.25/);
    assert.ok(difference(marble, await linear(page)) > 0.01);
    const { rmse } = await againstDaemon(page);
    console.log(
      `  of another index, against the daemon's picture: ${(100 * rmse).toFixed(2)} %`,
    );
    assert.ok(rmse < 0.02, `relative RMSE ${rmse}`);
    await shot(page, "any-eta");
    await page.context().close();
  },

  async "one list is open at a time, and Escape closes it"(home) {
    for (const viewport of [
      { width: 1280, height: 800 },
      { width: 360, height: 640 },
    ]) {
      const page = await open(`${home}/#model=marble.prt`, { viewport });
      await mode(page, "mesh");
      const lists = () =>
        page.locator(".drawer").evaluateAll((all) => all.map((one) => one.ariaLabel));
      await page.getByRole("button", { name: "marble.prt" }).click();
      assert.deepEqual(await lists(), ["Models"]);
      await page.getByRole("button", { name: "Rooms", exact: true }).click();
      assert.deepEqual(await lists(), ["Rooms"]);
      await page.getByLabel("A new room about this picture").fill("Bunny");
      const create = page.getByRole("button", { name: "Create the room" });
      await shot(page, `rooms-${viewport.width}`);
      // Whole, and over everything else.
      assert.ok(
        await create.evaluate((node) => {
          const { left, right, top, bottom } = node.getBoundingClientRect();
          return [top + 2, bottom - 2].every(
            (y) => document.elementFromPoint((left + right) / 2, y) === node,
          );
        }),
      );
      await page.keyboard.press("Escape");
      assert.deepEqual(await lists(), []);
      await page.context().close();
    }
  },

  async "no words are cut, also on a phone"(home) {
    for (const viewport of [
      { width: 1280, height: 800 },
      { width: 360, height: 640 },
    ]) {
      const page = await open(`${home}/#model=marble.prt`, { viewport });
      await mode(page, "mesh");
      const cut = (words) =>
        page
          .locator(words)
          .evaluateAll((all) =>
            all.filter((one) => one.scrollWidth > one.clientWidth).map((one) => one.innerText),
          );
      assert.deepEqual(await cut(".card > span, .rooms-button span"), []);
      await shot(page, `light-${viewport.width}`);
      await page.getByRole("tab", { name: "View" }).click();
      await shot(page, `view-${viewport.width}`);
      assert.deepEqual(await cut(".tab-panel"), []);
      await page.context().close();
    }
  },

  async "a number that is not taken does not stay in its field"(home) {
    const page = await open(`${home}/#model=marble.prt&ev=8`);
    await page.getByRole("tab", { name: "View" }).click();
    const field = page.getByLabel("Exposure, number");
    for (const [typed, shown] of [
      ["100", "8"],
      ["", "8"],
      ["2.5", "2.5"],
    ]) {
      await field.fill(typed);
      await field.press("Enter");
      await field.blur();
      assert.equal(await field.inputValue(), shown);
    }
    await page.getByRole("tab", { name: "Light" }).click();
    const turn = page.getByRole("slider", { name: "Turn" });
    await turn.fill("1000"); // its right end
    assert.equal(await turn.inputValue(), "1000");
    await page.context().close();
  },

  async "thickness is drawn in place of light, as rays find it"(home) {
    const page = await open(`${home}/#model=marble.prt&orbit=30,20,1`);
    await mode(page, "mesh");
    await settled(page);
    await page.getByRole("tab", { name: "View" }).click();
    await page.getByRole("radio", { name: "Thickness" }).click();
    await page.getByText(/yellow 10 mm/).waitFor(PATIENCE);
    assert.match(page.url(), /heat=thickness/);
    await settled(page);
    await shot(page, "thickness");
    const found = await page.evaluate(() => {
      const { stage, shape } = globalThis.relightViewer;
      const [w, h] = [160, 120];
      const drawn = stage.readThickness(w, h);
      const { camera } = stage;
      const aspect = camera.aspect;
      const tan = Math.tan((camera.fov * Math.PI) / 360);
      const m = camera.matrixWorld.elements;
      const turn = (d) => [0, 1, 2].map((i) => m[i] * d[0] + m[4 + i] * d[1] + m[8 + i] * d[2]);
      const less = (a, b) => a.map((x, i) => x - b[i]);
      const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
      const cross = (a, b) =>
        [0, 1, 2].map((i) => {
          const [j, k] = [(i + 1) % 3, (i + 2) % 3];
          return a[j] * b[k] - a[k] * b[j];
        });
      const eye = [m[12], m[13], m[14]];
      const point = (v) => Array.from(shape.positions.subarray(3 * v, 3 * v + 3));
      return [
        [80, 60],
        [70, 66],
        [86, 50],
        [76, 45],
      ].map(([x, y]) => {
        const d = turn(
          [(2 * (x + 0.5)) / w - 1, (2 * (y + 0.5)) / h - 1, -1].map(
            (c, i) => c * [tan * aspect, tan, 1][i],
          ),
        );
        const unit = Math.hypot(...d);
        let sum = 0;
        for (let t = 0; t < shape.triangles.length; t += 3) {
          const [a, b, c] = [0, 1, 2].map((k) => point(shape.triangles[t + k]));
          const [e1, e2] = [less(b, a), less(c, a)];
          const p = cross(d, e2);
          const det = dot(e1, p);
          if (Math.abs(det) < 1e-12) continue;
          const o = less(eye, a);
          const u = dot(o, p) / det;
          const q = cross(o, e1);
          const v = dot(d, q) / det;
          if (u < 0 || v < 0 || u + v > 1) continue;
          sum += (det > 0 ? -1 : 1) * (dot(e2, q) / det) * unit * shape.mmPerUnit;
        }
        return [drawn[y * w + x], sum];
      });
    });
    for (const [drawn, traced] of found)
      assert.ok(traced > 1 && Math.abs(drawn - traced) < 0.05 * traced, `${drawn} ${traced}`);
    await page.getByRole("radio", { name: "All" }).click();
    await settled(page);
    assert.ok(!page.url().includes("heat="));
    await page.context().close();
  },

  async "errors of the bake and of the dipole are drawn where they were measured"(home) {
    const page = await open(`${home}/#model=marble.prt&orbit=30,20,1`);
    await mode(page, "mesh");
    await settled(page);
    await page.getByRole("tab", { name: "View" }).click();
    for (const [heat, words] of [
      ["error", /Measured at \d+ vertices/],
      ["dipole", /against random walks/],
    ]) {
      await page.getByRole("radio", { name: heat === "error" ? "Error" : "Dipole" }).click();
      await page.getByText(words).waitFor(PATIENCE);
      assert.ok(page.url().includes(`heat=${heat}`));
      await settled(page);
      await shot(page, heat);
      const found = await farFromPlaces(page, heat);
      assert.ok(found.length > 20, `${found.length} places`);
      const off = found.filter((far) => far > 0.06).length;
      assert.ok(
        off < 0.1 * found.length,
        `${heat}: ${off} of ${found.length} have another colour`,
      );
    }
    await page.getByRole("radio", { name: "All" }).click();
    await settled(page);
    assert.ok(!page.url().includes("heat="));
    await page.context().close();
  },

  async "one object's medium is edited, in the link, and undone"(home) {
    const page = await open(`${home}/#model=toy.prt&material.Left=cream`);
    await mode(page, "mesh");
    await coefficients(page);
    const before = await linear(page);
    await page.getByRole("tab", { name: "Material" }).click();
    await page.getByRole("radio", { name: "Right" }).click();
    await page.getByRole("radio", { name: "Ketchup" }).click();
    await settled(page);
    assert.ok(difference(before, await linear(page)) > 0.05);
    assert.match(page.url(), /material\.Left=cream&material\.Right=ketchup/);
    const { rmse } = await againstDaemon(page);
    console.log(
      `  one object edited, against the daemon's picture: ${(100 * rmse).toFixed(2)} %`,
    );
    assert.ok(rmse < 0.02, `relative RMSE ${rmse}`);
    await shot(page, "material-object");
    await page.keyboard.press("Control+z");
    await settled(page);
    assert.ok(difference(before, await linear(page)) < 1e-3);
    await page.context().close();
  },

  async "two states are compared: a wipe, side by side, a map of ΔE"(home) {
    const page = await open(`${home}/#model=open.prt&orbit=0,15,1,0,-0.5`);
    await mode(page, "mesh");
    await coefficients(page);
    const alone = await linear(page);
    await page.getByRole("tab", { name: "View" }).click();
    await page.getByRole("button", { name: "Keep this as B" }).click();
    await page.waitForFunction(
      () => globalThis.relightOther?.status.frames > 0,
      null,
      PATIENCE,
    );
    const otherRests = () =>
      page.waitForFunction(() => globalThis.relightOther.settled, null, PATIENCE);
    const drawnByOther = () =>
      page.evaluate(() => Array.from(globalThis.relightOther.stage.readLinear(160, 120)));
    await otherRests();
    await page.getByRole("radio", { name: "ΔE map" }).click();
    await page.getByText("mean 0.00, most 0.0").waitFor(PATIENCE);
    await page.getByRole("tab", { name: "Material" }).click();
    await page.getByRole("radio", { name: "Ketchup" }).click();
    await settled(page);
    await page.getByRole("tab", { name: "View" }).click();
    await page.getByText(/mean [1-9][0-9]*\.[0-9]+, most [1-9]/).waitFor(PATIENCE);
    await shot(page, "difference");
    const [shown, pictures] = await heights(page);
    assert.ok(pictures < 0.4, `the model is at the height ${pictures}`);
    assert.ok(Math.abs(shown - pictures) < 0.05, `the map is at ${shown}, not ${pictures}`);
    await page.getByRole("radio", { name: "Wipe" }).click();
    await settled(page);
    await otherRests();
    assert.ok(difference(await drawnByOther(), alone) < 2e-3);
    assert.ok(difference(await linear(page), alone) > 0.1);
    await shot(page, "wipe");
    // A hand moves the line, and not the model with it.
    const compared = () =>
      page.evaluate(() => {
        const { compare, orbit } = globalThis.relightViewer.state;
        return [compare.at, orbit.azimuth];
      });
    assert.deepEqual(await compared(), [0.5, 0]);
    await drag(page, [323, 200], [-99, 0]);
    assert.deepEqual(await compared(), [0.35, 0]);
    // Both turn together; the wipe is a clip of B, so that the panes have one size.
    await drag(page, [150, 200], [60, 0]);
    await settled(page);
    await otherRests();
    assert.ok(difference(await drawnByOther(), alone) > 0.02);
    await page.getByRole("radio", { name: "Side by side" }).click();
    await settled(page);
    await otherRests();
    const widths = await page.evaluate(() =>
      [...document.querySelectorAll(".pane")].map((pane) => pane.clientWidth),
    );
    assert.equal(widths.length, 2);
    assert.ok(Math.abs(widths[0] - widths[1]) < 2 && widths[0] < 330);
    await shot(page, "side-by-side");
    const [before, b] = [await linear(page), await drawnByOther()];
    const link = page.url();
    assert.match(link, /compare=side/);
    const again = await open(link);
    await mode(again, "mesh");
    await coefficients(again);
    await again.waitForFunction(
      () =>
        globalThis.relightOther?.status.stream === "coefficients" &&
        globalThis.relightOther.settled,
      null,
      PATIENCE,
    );
    assert.ok(difference(await linear(again), before) < 2e-3);
    const theirs = await again.evaluate(() =>
      Array.from(globalThis.relightOther.stage.readLinear(160, 120)),
    );
    assert.ok(difference(theirs, b) < 2e-3);
    await again.context().close();
    await page.getByRole("button", { name: "Swap A and B" }).click();
    await settled(page);
    await otherRests();
    assert.ok(difference(await linear(page), b) < 5e-3);
    await page.evaluate(() => (globalThis.ended = document.querySelector(".pane.b .gl")));
    await page.getByRole("button", { name: "End" }).click();
    await page.waitForFunction(() => document.querySelectorAll(".pane").length === 1);
    // A browser has few contexts: the one of B is free again.
    await page.waitForFunction(() => globalThis.ended.getContext("webgl2").isContextLost());
    await page.context().close();
  },

  async "on a slow link states overlap, and coarse frames end in the exact one"(home, port) {
    const link = new SlowLink(port, 625_000, 40);
    const near = `http://127.0.0.1:${await link.listen()}`;
    const state = "#model=toy.prt&light=page:window@0,0";
    const page = await open(near + "/" + state);
    await mode(page, "mesh");
    await coefficients(page);
    await page.evaluate(() => {
      const { quality } = globalThis.relightViewer.stage;
      Object.assign(quality, { moving: 0, leastLevel: 0, drawn: () => undefined }); // the link alone
    });
    await noteFrames(page);
    const say = (what, frames) => {
      const s = Math.max(1, frames.at(-1).atMs - frames[0].atMs) / 1000;
      const delays = frames.map(({ delayMs }) => delayMs).sort((a, b) => a - b);
      console.log(
        `  ${what}: ${(frames.length / s).toFixed(1)} frames/s of ` +
          `${(frames.at(-1).bytes / 1000).toFixed(1)} kB, delay ` +
          `${delays[delays.length >> 1].toFixed(0)} ms (median), outstanding at most ` +
          `${Math.max(...frames.map(({ waits }) => waits))}`,
      );
    };
    const wide = await turnUntil(page, (frames) => frames.length >= 40);
    say("5 Mbit/s, 80 ms", wide);
    const most = Math.max(...wide.map(({ waits }) => waits));
    assert.ok(most >= 2 && most <= 4, `${most} states outstanding`);
    // So thin that a whole frame takes 300 ms: those of the moving hand have fewer rows.
    const whole = Math.max(...wide.map(({ bytes }) => bytes));
    link.rate = whole / 0.3;
    const thin = await turnUntil(page, (frames) => frames.some(({ rows }) => rows > 0));
    say("300 ms a frame", thin);
    const coarse = thin.find(({ rows }) => rows > 0);
    assert.ok(coarse.rows === 16 || coarse.rows === 8, `${coarse.rows} rows`);
    assert.ok(Math.max(...thin.map(({ waits }) => waits)) <= 4);
    link.rate = 625_000;
    await settled(page);
    const last = await page.evaluate(() => globalThis.frames.at(-1));
    assert.equal(last.rows, 0);
    const other = await open(home + "/" + new URL(page.url()).hash);
    await mode(other, "mesh");
    await coefficients(other);
    const exact = await linear(other);
    assert.ok(difference(await linear(page), exact) < 1e-3);
    await other.context().close();
    // A coarse frame is the same picture with less detail.
    await page.evaluate(() => {
      const { view } = globalThis.relightViewer;
      view.rest = () => undefined; // the exact frame would follow
      view.put(view.last, 2, false);
    });
    await page.waitForFunction(
      () => globalThis.frames.at(-1).rows === 8 && globalThis.relightViewer.view.waits === 0,
      null,
      PATIENCE,
    );
    const off = difference(await linear(page), exact);
    console.log(`  8 rows of a cluster: ${(100 * off).toFixed(1)} % from the exact picture`);
    assert.ok(off > 1e-4 && off < 0.1);
    await page.context().close();
    link.close();
  },

  async "a file is seen at once, baked, and swapped in"(home) {
    const page = await open(`${home}/`);
    await mode(page, "mesh");
    await page.getByRole("button", { name: /prt/ }).click();
    await page.locator(".bring input[type=file]").setInputFiles(join(folder, "bumps.obj"));
    await mode(page, "pictures");
    await shot(page, "baking");
    await mode(page, "mesh");
    await settled(page);
    assert.equal(await page.locator("canvas.picture").isVisible(), false);
    await page.context().close();
  },

  async "a file whose z axis points up and whose textures lie upside down"(home) {
    const shape = (page) =>
      page.evaluate(() => {
        const { positions, uv } = globalThis.relightViewer.mesh;
        return { at: Array.from(positions), uv: Array.from(uv[0]) };
      });
    const page = await open(`${home}/#model=toy.prt`);
    await mode(page, "mesh");
    const before = await shape(page);
    await page.getByRole("button", { name: /prt/ }).click();
    await page.getByLabel("Its z axis points up").check();
    await page.getByLabel("Its textures lie upside down").check();
    await shot(page, "upload-settings");
    await page.locator(".bring input[type=file]").setInputFiles(join(folder, "toy.glb"));
    await page.waitForFunction(
      (height) => globalThis.relightViewer.mesh?.positions[1] !== height,
      before.at[1],
      PATIENCE,
    );
    await mode(page, "mesh");
    const after = await shape(page);
    before.at.forEach((x, i) => {
      const want = i % 3 === 0 ? x : i % 3 === 1 ? before.at[i + 1] : -before.at[i - 1];
      assert.ok(Math.abs(after.at[i] - want) < 1e-5, `${i}: ${after.at[i]}, not ${want}`);
    });
    before.uv.forEach((x, i) => {
      const want = i % 2 ? 1 - x : x;
      assert.ok(Math.abs(after.uv[i] - want) < 1e-6, `uv ${i}: ${after.uv[i]}, not ${want}`);
    });
    await page.context().close();
  },

  async "the daemon goes and comes back; the page loses nothing"(home, port) {
    const page = await open(`${home}/#model=marble.prt&light=page:rim@120,0&orbit=40,10,1`);
    await mode(page, "mesh");
    await coefficients(page);
    const before = await linear(page);
    await stop();
    await page.getByText("Offline").waitFor(PATIENCE);
    await shot(page, "offline");
    await start(port);
    await page.getByText("Offline").waitFor({ state: "hidden", ...PATIENCE });
    await coefficients(page);
    const off = difference(await linear(page), before);
    assert.ok(off < 1e-3, `relative RMSE ${off}`);
    await page.context().close();
  },

  async "without WebGL the daemon draws"(home) {
    const page = await open(`${home}/?no-webgl=1#model=marble.prt`);
    await mode(page, "pictures");
    await page.getByText("no WebGL 2").waitFor(PATIENCE);
    await page.waitForFunction(
      () => !document.querySelector("canvas.picture").hidden,
      null,
      PATIENCE,
    );
    const picture = () =>
      page.evaluate(() => document.querySelector("canvas.picture").toDataURL());
    const before = await picture();
    await drag(page, [150, 200], [80, 0]);
    await page.waitForFunction(
      (old) => document.querySelector("canvas.picture").toDataURL() !== old,
      before,
      PATIENCE,
    );
    await shot(page, "no-webgl");
    await page.evaluate(() => (location.hash = "model=marble.prt&heat=thickness"));
    await page.getByRole("tab", { name: "View" }).click();
    await page
      .getByText(/^Thickness is drawn where the page has the surface/)
      .waitFor(PATIENCE);
    const both = "model=marble.prt&compare=difference@0.5&other=model%3Dmarble.prt";
    await page.evaluate((hash) => (location.hash = hash), both);
    await page.getByText(/^There is no map: the daemon draws/).waitFor(PATIENCE);
    assert.equal(await page.locator("canvas.map").isVisible(), false);
    await page.context().close();
  },

  async "a phone, in light colours; nothing serious for axe"(home) {
    for (const [name, options] of [
      [
        "phone",
        {
          viewport: { width: 360, height: 640 },
          colorScheme: "light",
          hasTouch: true,
        },
      ],
      ["desk", { viewport: { width: 1280, height: 800 }, colorScheme: "dark" }],
    ]) {
      const page = await open(`${home}/#model=open.prt`, options);
      await mode(page, "mesh");
      await settled(page);
      assert.equal(
        await page.evaluate(() => document.documentElement.scrollWidth),
        options.viewport.width,
      );
      const stage = await page.locator(".stage").boundingBox();
      assert.ok(stage.width >= 300 && stage.height >= 240);
      for (const tab of ["Light", "Material", "View"]) {
        await page.getByRole("tab", { name: tab }).click();
        await shot(page, `${name}-${tab.toLowerCase()}`);
        const found = await page.evaluate(`${axe}; axe.run(document)`);
        const serious = found.violations.filter(
          ({ impact }) => impact === "serious" || impact === "critical",
        );
        assert.deepEqual(
          serious.map(({ id, nodes }) => `${id}: ${nodes.map(({ html }) => html).join(" ")}`),
          [],
        );
      }
      assert.match(
        await page.locator("#stage-text").textContent(),
        /open\.prt.*lit by Soft boxes/,
      );
      await page.context().close();
    }
  },

  async "a shop's page embeds the viewer: the daemon's picture first, then the model"(
    home,
    port,
  ) {
    const example = readFileSync(join(web, "examples/embed.html"), "utf8")
      .replaceAll("http://127.0.0.1:8080", home)
      .replace('model="bunny"', 'model="marble.prt"')
      .replace('environment="page:sunset"', 'environment="constant"');
    const made = join(folder, "package");
    const packed = spawnSync(process.execPath, [
      join(web, "scripts/package.mjs"),
      "--out",
      made,
    ]);
    assert.equal(packed.status, 0, String(packed.stderr));
    const shop = createServer(({ url }, answer) => {
      const script = url.endsWith(".js");
      answer.setHeader("content-type", script ? "text/javascript" : "text/html; charset=utf-8");
      if (url === "/") answer.end(example);
      else {
        const text = readFileSync(join(made, new URL(url, "http://shop").pathname), "utf8");
        answer.end(
          text
            .replace("ws://127.0.0.1:8080", home.replace("http", "ws"))
            .replace('"bunny"', '"marble.prt"'),
        );
      }
    });
    await new Promise((resolve) => shop.listen(0, "127.0.0.1", resolve));
    const origin = `http://127.0.0.1:${shop.address().port}`;
    await stop();
    await start(port, ["--origins", origin]);
    try {
      const page = await open("about:blank");
      const posters = [];
      page.on("response", (answer) => {
        if (answer.url().includes("/v1/models/")) posters.push(answer.status());
      });
      await page.goto(origin);
      const has = (script) => page.waitForFunction(script, null, PATIENCE);
      await has(() => document.querySelector("relight-viewer")?.viewer?.status.mode === "mesh");
      await has(
        () => document.querySelector("relight-viewer").shadowRoot.querySelector("img").hidden,
      );
      await has(
        () => document.querySelector("relight-viewer").viewer.status.stream === "coefficients",
      );
      assert.deepEqual(posters, [200]);
      const found = await page.evaluate(async () => {
        const one = document.querySelector("relight-viewer");
        const parts = [...one.shadowRoot.querySelectorAll("[part]")].map(
          (node) => node.part.value,
        );
        const moved = new Promise((resolve) =>
          one.addEventListener("camera-change", ({ detail }) => resolve(detail.azimuth)),
        );
        one.cameraOrbit = { ...one.cameraOrbit, azimuth: 77 };
        const blob = await one.toBlob("image/png");
        return {
          parts,
          azimuth: await moved,
          type: blob.type,
          size: blob.size,
        };
      });
      assert.deepEqual(found.parts.sort(), [
        "canvas",
        "message",
        "picture",
        "poster",
        "progress",
      ]);
      assert.equal(found.azimuth, 77);
      // The camera and the light stay where hands put them until their own attributes change.
      const stays = await page.evaluate(() => {
        const one = document.querySelector("relight-viewer");
        const told = [];
        one.addEventListener("light-change", ({ detail }) => told.push(detail));
        const now = () => {
          one.turnLight(0);
          return [one.cameraOrbit.azimuth, told.at(-1).rotate, told.at(-1).tilt];
        };
        one.setAttribute("rotate", "20");
        one.cameraOrbit = { ...one.cameraOrbit, azimuth: 50 };
        one.turnLight(30, 5);
        one.setAttribute("exposure", "1");
        const states = [[...now(), one.state.exposure]];
        one.setAttribute("rotate", "70");
        states.push(now());
        one.setAttribute("camera-orbit", "10deg 20deg");
        states.push(now());
        one.removeAttribute("camera-orbit");
        states.push(now());
        return states;
      });
      assert.deepEqual(stays, [
        [50, 50, 5, 1],
        [50, 70, 5],
        [10, 70, 5],
        [10, 70, 5],
      ]);
      // Without interaction the wheel and fingers are the page's.
      const hands = await page.evaluate(() => {
        const one = document.querySelector("relight-viewer");
        const stage = one.shadowRoot.querySelector(".stage");
        return ["none", "orbit"].map((word) => {
          one.setAttribute("interaction", word);
          const wheel = new WheelEvent("wheel", { deltaY: 1, cancelable: true });
          stage.dispatchEvent(wheel);
          const { touchAction } = getComputedStyle(stage);
          const role = stage.getAttribute("role");
          return [wheel.defaultPrevented, touchAction, role, stage.tabIndex];
        });
      });
      assert.deepEqual(hands, [
        [false, "auto", "img", -1],
        [true, "none", "application", 0],
      ]);
      // The camera turns by itself until a hand turns it.
      const turned = await page.evaluate(async () => {
        const one = document.querySelector("relight-viewer");
        const stage = one.shadowRoot.querySelector(".stage");
        const frames = (n) =>
          new Promise((done) => {
            const next = () => (n-- ? requestAnimationFrame(next) : done());
            next();
          });
        const azimuths = [one.cameraOrbit.azimuth];
        one.setAttribute("auto-rotate", "");
        await frames(5);
        azimuths.push(one.cameraOrbit.azimuth);
        stage.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" }));
        azimuths.push(one.cameraOrbit.azimuth);
        await frames(5);
        azimuths.push(one.cameraOrbit.azimuth);
        one.removeAttribute("auto-rotate");
        return azimuths;
      });
      assert.notEqual(turned[1], turned[0]);
      assert.notEqual(turned[2], turned[1]);
      assert.equal(turned[3], turned[2]);
      // The message of a lost connection ends with it, without a model too.
      await page.evaluate(() => {
        const one = document.querySelector("relight-viewer");
        one.removeAttribute("model");
        one.client.socket.close();
      });
      const offline = page.getByText("Offline; it connects again by itself.");
      await offline.waitFor(PATIENCE);
      await offline.waitFor({ ...PATIENCE, state: "hidden" });
      // The picture before the model is of the variant.
      const before = await page.evaluate(async () => {
        const one = document.querySelector("relight-viewer");
        one.setAttribute("tilt", "0"); // HTTP tilts no light
        one.setAttribute("model", "variants.prt");
        const pictures = [];
        for (const variant of ["", "day"]) {
          one.setAttribute("variant", variant);
          const answer = await fetch(one.drawnPoster());
          pictures.push(
            `${answer.status} ${new Uint8Array(await answer.arrayBuffer()).join()}`,
          );
        }
        return pictures;
      });
      assert.ok(
        before.every((picture) => picture.startsWith("200 ")),
        before[0].slice(0, 99),
      );
      assert.notEqual(before[0], before[1]);
      assert.ok(found.type === "image/png" && found.size > 1000);
      await shot(page, "embed");
      // The example of the client alone, from the package.
      await page.goto(`${origin}/examples/client.html`);
      await page.getByText(/^[0-9]+ vertices, mean radiance 0\.[0-9]+$/).waitFor(PATIENCE);
      await page.context().close();
    } finally {
      shop.close();
      await stop();
      await start(port);
    }
  },

  ...streamScenarios({
    open,
    mode,
    coefficients,
    settled,
    linear,
    difference,
    againstDaemon,
    PATIENCE,
  }),
  ...roomScenarios({ open, mode, shot, axe, roomLog, PATIENCE }),
  ...ownScenarios({ open, mode, shot, roomLog, bin, folder, PATIENCE }),
  ...faultScenarios({ open, mode, shot, folder, PATIENCE }),
  ...replicaScenarios({ open, mode, start, stop, daemon: () => daemon, folder, PATIENCE }),
  ...reviewScenarios({ open, mode, settled, shot, axe, roomLog, PATIENCE }),

  // Last: a token closes the daemon for the others.
  async "a token is wanted, and rights are respected"(home, port) {
    await stop();
    writeFileSync(join(folder, "token"), `relight_${"k".repeat(43)}\n`, {
      mode: 0o600,
    });
    await start(port, ["--token-file", join(folder, "token")]);
    const made = spawnSync(join(bin, "relight"), [
      ...[
        "-s",
        `unix:${join(folder, "socket")}`,
        "token",
        "create",
        "--name",
        "guest",
        "--scope",
        "view",
      ],
    ]);
    assert.equal(made.status, 0, String(made.stderr));
    const guest = /relight_\S+/.exec(String(made.stdout))[0];
    const page = await open(`${home}/#model=marble.prt`);
    await page.getByText("Not permitted").waitFor(PATIENCE);
    await shot(page, "token");
    await page.getByLabel("Token").fill(guest);
    await page.getByRole("button", { name: "Connect" }).click();
    await mode(page, "mesh");
    assert.equal(await page.getByText("HDR, EXR…").count(), 0);
    await page.getByRole("button", { name: /^Rooms/ }).click();
    await page.getByText("This token may not make a room").waitFor(PATIENCE);
    assert.equal(await page.getByRole("button", { name: "Create the room" }).count(), 0);
    assert.ok(!page.url().includes("relight_"));
    const byLink = await open(`${home}/#model=marble.prt&token=${guest}`);
    await mode(byLink, "mesh");
    assert.ok(!byLink.url().includes("relight_"));
  },
};

// ---- run

let failed = 0;
try {
  bake();
  const port = await start();
  browser = await chromium.launch({
    executablePath: browserPath,
    args: [
      "--no-sandbox",
      "--use-gl=angle",
      "--use-angle=swiftshader",
      "--enable-unsafe-swiftshader",
      "--force-color-profile=srgb",
    ],
  });
  if (shots) mkdirSync(shots, { recursive: true });
  for (const [name, run] of Object.entries(scenarios)) {
    if (process.env.ONLY && !new RegExp(process.env.ONLY).test(name)) continue;
    const begin = Date.now();
    try {
      await run(`http://127.0.0.1:${port}`, port);
      assert.deepEqual(faults, [], "errors in the console");
      console.log(`ok   ${name} (${((Date.now() - begin) / 1e3).toFixed(1)} s)`);
    } catch (error) {
      failed++;
      faults.length = 0;
      console.log(`FAIL ${name}\n${error.stack}`);
    }
  }
} finally {
  await browser?.close();
  await stop().catch(() => undefined);
  rmSync(folder, { recursive: true, force: true });
}
process.exit(failed ? 1 : 0);
