// SPDX-License-Identifier: MIT
// What the two streams of light carry: planes of exit, colours of fewer vertices, variants. For page.mjs.
import assert from "node:assert/strict";
import { noteFrames, SlowLink, turnUntil } from "./slow-link.mjs";

/** tools: functions of page.mjs. */
export function streamScenarios({
  open,
  mode,
  coefficients,
  settled,
  linear,
  difference,
  againstDaemon,
  PATIENCE,
}) {
  const percent = (x) => `${(100 * x).toFixed(2)} %`;
  const streamIs = (page, stream) =>
    page.waitForFunction(
      (wanted) => globalThis.relightViewer.status.stream === wanted,
      stream,
      PATIENCE,
    );

  return {
    async "the panel of variants draws each as the daemon does, by both streams"(home) {
      const page = await open(`${home}/#model=variants.prt&light=page:window@40,0`);
      await mode(page, "mesh");
      await coefficients(page);
      const panel = page.getByRole("radiogroup", { name: "Variant" });
      if (!(await panel.isVisible())) await page.getByRole("tab", { name: "Material" }).click();
      const before = await linear(page);
      for (const name of ["day", "dark"]) {
        await panel.getByRole("radio", { name }).click();
        await page.waitForFunction(
          (wanted) => globalThis.relightViewer.state.variant === wanted,
          name,
          PATIENCE,
        );
        await settled(page);
        const { rmse, pixels } = await againstDaemon(page);
        const changed = difference(await linear(page), before);
        console.log(
          `  ${name}: ${percent(rmse)} of ${pixels} pixels, ${percent(changed)} from before`,
        );
        assert.ok(pixels > 2000);
        assert.ok(rmse < 0.02, `relative RMSE ${rmse}`);
        assert.ok(changed > 0.03, `${name} changes ${changed}`);
      }
      assert.ok(page.url().includes("variant=dark"));
      await page.context().close();
    },

    async "planes of exit are drawn from several eyes, by both streams"(home) {
      const forward = '{"sigma_s_prime":[0.5,0.5,0.5],"sigma_a":[0.02,0.05,0.1],"g":0.3}';
      for (const [model, material, term] of [
        ["thin.prt", "", "total"],
        ["thin.prt", "", "single"],
        ["thin-open.prt", forward, "total"],
      ]) {
        const state = new URLSearchParams({ model, material, term, light: "page:window@40,0" });
        const page = await open(`${home}/#${state}`);
        await mode(page, "mesh");
        await coefficients(page);
        for (const azimuth of [0, 90, 200]) {
          state.set("orbit", `${azimuth},${azimuth / 10 - 5},1`);
          await page.evaluate((hash) => (location.hash = hash), state.toString());
          await page.waitForFunction(
            (a) => Math.abs(globalThis.relightViewer.state.orbit.azimuth - a) < 1e-3,
            azimuth,
            PATIENCE,
          );
          await settled(page);
          const { rmse, pixels } = await againstDaemon(page);
          console.log(
            `  ${model} ${term}, eye at ${azimuth}°: ${percent(rmse)} of ${pixels} pixels`,
          );
          assert.ok(pixels > 5000);
          assert.ok(rmse < 0.02, `relative RMSE ${rmse}`);
        }
        const drawn = await linear(page);
        await page.evaluate(() => globalThis.relightViewer.useCoefficients(false));
        await streamIs(page, "colours, halves");
        await settled(page);
        const both = difference(await linear(page), drawn);
        console.log(`  ${model} ${term}: colours against coefficients ${percent(both)}`);
        assert.ok(both < 0.002, `relative RMSE ${both}`);
        await page.context().close();
      }
    },

    // What a resting eye sees is kept where the GPU is slow: the same picture under any light.
    async "a resting surface is lit by both streams as the surface itself"(home) {
      const forward = '{"sigma_s_prime":[0.5,0.5,0.5],"sigma_a":[0.02,0.05,0.1],"g":0.3}';
      for (const [model, material] of [
        ["marble.prt", ""],
        ["thin-open.prt", forward],
        ["variants.prt", ""],
      ]) {
        const state = new URLSearchParams({ model, material, light: "page:window@40,0" });
        const page = await open(`${home}/#${state}`);
        await mode(page, "mesh");
        await coefficients(page);
        for (const on of [true, false]) {
          await page.evaluate((c) => globalThis.relightViewer.useCoefficients(c), on);
          for (const light of ["page:window@40,0", "page:window@190,20"]) {
            await page.evaluate((l) => {
              const hash = new URLSearchParams(location.hash.slice(1));
              hash.set("light", l);
              location.hash = hash;
            }, light);
            await settled(page);
            const [still, own, seen] = await page.evaluate(async () => {
              const [w, h] = [160, 120];
              const { stage } = globalThis.relightViewer;
              await stage.makeStill("test", w, h);
              const Target = stage.screen.target(2, stage.canvas).constructor;
              const target = new Target(w, h, { type: 1015 }); // floats
              const curve = stage.shared.curve.value;
              stage.value("curve", 3); // linear
              stage.drawStill(target, stage.still);
              stage.value("curve", curve);
              const out = new Float32Array(4 * w * h);
              stage.renderer.readRenderTargetPixels(target, 0, 0, w, h, out);
              target.dispose();
              const own = stage.readLinear(w, h, 1);
              return [Array.from(out), Array.from(own), stage.still.visible.length];
            });
            const off = difference(still, own);
            console.log(
              `  ${model} ${light}, ${on ? "coefficients" : "colours"}: ${percent(off)} of ${seen} vertices`,
            );
            assert.ok(seen > 100);
            assert.ok(off < 0.005, `relative RMSE ${off}`);
          }
        }
        await page.context().close();
      }
    },

    async "a surface that rests is kept as soon as the light is turned"(home) {
      const page = await open(`${home}/#model=marble.prt&light=page:window@40,0`);
      await mode(page, "mesh");
      await coefficients(page);
      await settled(page);
      await page.evaluate(() => {
        const { stage } = globalThis.relightViewer;
        const drawStill = stage.drawStill.bind(stage);
        Object.assign(stage.quality, { moving: 2, drawn: () => undefined }); // a slow GPU
        globalThis.stills = 0;
        stage.drawStill = (...of) => {
          globalThis.stills++;
          drawStill(...of);
        };
      });
      await noteFrames(page);
      const seen = await turnUntil(page, (frames) => frames.length > 40);
      const stills = await page.evaluate(() => globalThis.stills);
      console.log(`  ${stills} of ${seen.length} frames`);
      assert.ok(stills > 20);
      await settled(page);
      const { rmse } = await againstDaemon(page);
      assert.ok(rmse < 0.02, `relative RMSE ${rmse}`);
      await page.context().close();
    },

    // A closed surface is drawn from outside only, unless the eye may be in it: in a room of opaque walls.
    async "walls about the eye are drawn from inside"(home) {
      const page = await open(`${home}/#model=marble.prt&light=page:window@40,0`);
      await mode(page, "mesh");
      await settled(page);
      const [outside, inside] = await page.evaluate(() => {
        const { stage, state } = globalThis.relightViewer;
        const sides = (reach) => {
          stage.reach = reach;
          globalThis.relightViewer.applyCamera(state);
          return stage.parts.map(({ material }) => material.side);
        };
        stage.closed = true; // as if its triangles closed it
        stage.setMaps(new Map());
        return [sides(0.1), sides(1e6)];
      });
      assert.deepEqual([outside, inside], [[0], [2]]); // FrontSide and DoubleSide of three.js
      await settled(page);
      const { rmse } = await againstDaemon(page);
      assert.ok(rmse < 0.02, `relative RMSE ${rmse}`);
      await page.context().close();
    },

    async "on a slow link colours are of fewer vertices, and end in the exact ones"(
      home,
      port,
    ) {
      const link = new SlowLink(port, 625_000, 40);
      const near = `http://127.0.0.1:${await link.listen()}`;
      const page = await open(`${near}/#model=marble.prt&light=page:window@0,0`);
      await mode(page, "mesh");
      await coefficients(page);
      await page.evaluate(() => globalThis.relightViewer.useCoefficients(false));
      await streamIs(page, "colours, RGB9E5");
      await settled(page);
      await noteFrames(page);
      const first = await turnUntil(page, (frames) => frames.length >= 3);
      const whole = Math.max(...first.map(({ bytes }) => bytes));
      link.rate = whole / 0.5; // a whole frame takes half a second
      const thin = await turnUntil(page, (frames) => frames.some(({ coarse }) => coarse > 0));
      const coarse = thin.find(({ coarse }) => coarse > 0);
      console.log(
        `  whole frames of ${whole} bytes, then ${coarse.bytes} of ${coarse.coarse} vertices`,
      );
      assert.ok(coarse.bytes < 0.6 * whole);
      link.rate = 625_000;
      await settled(page);
      const last = await page.evaluate(() => globalThis.frames.at(-1));
      assert.equal(last.coarse, 0);
      assert.equal(last.bytes, whole);
      const { rmse } = await againstDaemon(page);
      console.log(`  at rest, against the daemon's picture: ${percent(rmse)}`);
      assert.ok(rmse < 0.02, `relative RMSE ${rmse}`);
      await page.context().close();
      link.close();
    },
  };
}
