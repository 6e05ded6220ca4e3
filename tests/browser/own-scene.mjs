// SPDX-License-Identifier: MIT
// What a room shows of each person's own: someone who looks around alone is followed there; media by
// object and pins on a model without a bake are the room's. For page.mjs.
import { spawnSync } from "node:child_process";
import { copyFileSync } from "node:fs";
import { join } from "node:path";
import assert from "node:assert/strict";
import { people, roomOf } from "./people.mjs";

const stateOf = (page) =>
  page.evaluate(() => JSON.parse(JSON.stringify(globalThis.relightViewer.state)));

/** tools: as roomScenarios of rooms.mjs; bin and folder of page.mjs. */
export function ownScenarios({ open, mode, shot, roomLog, bin, folder, PATIENCE }) {
  const { enter, create, join: join_, rests, pin } = people({ open, mode, PATIENCE });
  const begin = (home, words, title, drawn) => create(home, words, "Ann", title, drawn);
  const relight = (...words) => {
    const done = spawnSync(join(bin, "relight"), [
      "-s",
      `unix:${join(folder, "socket")}`,
      ...words,
    ]);
    assert.equal(done.status, 0, String(done.stderr));
    return String(done.stdout);
  };
  const shown = (room) => JSON.parse(relight("room", "show", room, "--json"));
  const until = (page, test, argument) => page.waitForFunction(test, argument, PATIENCE);
  const turned = (deg) => Math.abs(globalThis.relightViewer.state.lamps[0].rotate - deg) < 1e-3;

  return {
    async "who looks around alone is followed there"(home) {
      const ann = await begin(home, "model=marble.prt&light=constant@20,0", "Alone");
      const bob = await join_(ann, "Bob Stone");
      await rests(ann);
      await ann.getByTitle(/^Bob Stone, /).waitFor(PATIENCE);
      await bob.locator(".stage").focus();
      await bob.keyboard.press("a");
      await ann.getByTitle(/Bob Stone, .*looks around alone/).waitFor(PATIENCE);
      await bob.evaluate(() => {
        location.hash = "model=open.prt&material=skin1&light=constant@77,0&exposure=1";
      });
      await until(bob, () => globalThis.relightViewer.info?.name === "open.prt");
      const before = roomLog(roomOf(ann)).length;
      await ann.getByTitle(/^Bob Stone, /).click();
      await ann.getByText("You see what Bob Stone sees alone.").waitFor(PATIENCE);
      await until(
        ann,
        () =>
          globalThis.relightViewer.info?.name === "open.prt" &&
          globalThis.relightViewer.state.material === "skin1",
      );
      await until(ann, turned, 77);
      assert.equal((await stateOf(ann)).exposure, (await stateOf(bob)).exposure);
      await ann.getByText("Stop following to decide").waitFor(PATIENCE);
      await shot(ann, "room-own");
      // It follows Bob's hand and camera; Ann's own hand changes nothing of the room.
      await bob.locator(".stage").focus();
      await bob.keyboard.press("Shift+ArrowRight");
      await bob.keyboard.press("ArrowUp");
      const there = await stateOf(bob);
      await until(ann, turned, there.lamps[0].rotate);
      await until(
        ann,
        (deg) => Math.abs(globalThis.relightViewer.state.orbit.elevation - deg) < 0.1,
        there.orbit.elevation,
      );
      await ann.locator(".stage").focus();
      await ann.keyboard.press("Shift+ArrowLeft");
      await rests(ann);
      // A pin is of what its author sees.
      await mode(ann, "mesh");
      await pin(ann, "in skin", [330, 360]);
      const log = roomLog(roomOf(ann)).slice(before);
      assert.deepEqual(
        log.map(({ action }) => Object.keys(action)[0]),
        ["pin"],
      );
      assert.equal(log[0].action.pin.scene.material, "skin1");
      // Back to all: Ann goes along, and keeps following the camera.
      await bob.locator(".stage").focus();
      await bob.keyboard.press("a");
      await until(ann, () => globalThis.relightViewer.info?.name === "marble.prt");
      await until(ann, turned, 20);
      await ann.getByText("The camera is Bob Stone’s.").waitFor(PATIENCE);
      // Alone again and gone: what is left is the room.
      await bob.keyboard.press("a");
      await bob.keyboard.press("Shift+ArrowRight");
      await until(
        ann,
        () => Math.abs(globalThis.relightViewer.state.lamps[0].rotate - 20) > 1e-3,
      );
      await bob.context().close();
      await until(ann, turned, 20);
      assert.equal(await ann.getByText("Stop following").count(), 0);
      // Lights of a room are turned, not raised: others could not see it.
      await ann.locator(".stage").focus();
      await ann.keyboard.press("Shift+ArrowUp");
      assert.equal((await stateOf(ann)).lamps[0].tilt, 0);
      await ann.getByRole("tab", { name: "Light" }).click();
      assert.equal(await ann.getByLabel("Height").count(), 0);
      await shot(ann, "room-light");
      await ann.context().close();
    },

    async "media by object and an engine are the room's"(home) {
      const ann = await begin(
        home,
        "model=toy.prt&light=constant@0,0&material.Left=ketchup",
        "Media",
      );
      const room = roomOf(ann);
      const bob = await join_(ann, "Bob");
      await until(bob, () => globalThis.relightViewer.state.materials.Left === "ketchup");
      relight("room", "scene", room, "--engine", "texture");
      // Events come in their order: with the name both have the engine, too.
      relight("room", "rename", room, "Media and engine");
      for (const page of [ann, bob])
        await page.locator(".room-name", { hasText: "Media and engine" }).waitFor(PATIENCE);
      const events = roomLog(room).length;
      await bob.evaluate(() => (globalThis.before = globalThis.relightViewer.state));
      await ann.evaluate(() => {
        location.hash = `${location.hash.replace("ketchup", "cream")}`;
      });
      await until(bob, () => globalThis.relightViewer.state.materials.Left === "cream");
      // Bob sees the hand first; the edit that keeps it comes when the hand rests.
      let { shade } = shown(room).scene;
      const end = Date.now() + PATIENCE.timeout;
      while (shade.materials[0]?.material !== "cream" && Date.now() < end) {
        await ann.waitForTimeout(100);
        ({ shade } = shown(room).scene);
      }
      assert.ok(roomLog(room).length > events);
      assert.deepEqual(shade.materials, [{ object: "Left", material: "cream" }]);
      assert.equal(shade.engine, "texture", "the page leaves what it does not show");
      await bob.context().close();
      await ann.context().close();
    },

    async "a pin goes onto a model without a bake"(home) {
      copyFileSync(join(folder, "bumps.obj"), join(folder, "models", "early.obj"));
      relight(
        ...["load", "early.obj", "--remote", "--name", "early", "--size-mm", "20"],
        ...["--material", "skin1", "--samples", "1000", "--preview"],
      );
      const ann = await begin(
        home,
        "model=early&light=constant@0,0",
        "Before the bake",
        "pictures",
      );
      await until(ann, () => globalThis.relightViewer.shape !== null);
      await pin(ann, "before the bake", [330, 360]);
      await ann.locator(".pin-mark").waitFor(PATIENCE);
      await shot(ann, "room-preview");
      const [{ seen, at }] = shown(roomOf(ann)).pins;
      assert.match(seen.mesh_hash, /^[0-9a-f]{16}$/);
      assert.ok(!seen.bake_hash);
      assert.equal(
        seen.engine,
        await ann.evaluate(() => globalThis.relightViewer.status.engine),
      );
      // An approval was of the preview: a bake that takes its place is told.
      await ann.getByRole("button", { name: "Approve", exact: true }).click();
      await ann.getByAltText("What the decision is about").waitFor(PATIENCE);
      await ann.getByRole("button", { name: "Approve this picture" }).click();
      await ann.getByText("approved as it is now").waitFor(PATIENCE);
      // A bake that comes between the look and the click is looked at first.
      await ann.getByRole("button", { name: "Reject", exact: true }).click();
      await ann.getByAltText("What the decision is about").waitFor(PATIENCE);
      relight(
        ...["load", "early.obj", "--remote", "--name", "early", "--size-mm", "20"],
        ...["--material", "skin1", "--samples", "1000", "--wait"],
      );
      await ann
        .getByText(/approved at revision \d+; the model was baked since/)
        .waitFor(PATIENCE);
      await ann.getByText(/ΔE₀₀ mean \d/).waitFor(PATIENCE);
      await shot(ann, "room-baked-since");
      await ann.getByText("has changed: look at it again, then decide").waitFor(PATIENCE);
      assert.equal(await ann.getByRole("button", { name: "Reject this picture" }).count(), 0);
      await ann.getByRole("button", { name: "Look again" }).click();
      await ann.getByAltText("What the decision is about").waitFor(PATIENCE);
      await ann.getByRole("button", { name: "Reject this picture" }).click();
      await ann.getByText("rejected as it is now").waitFor(PATIENCE);
      // On a bake of the same shape it has its triangle.
      await ann.evaluate(() => (location.hash = "model=marble.prt&light=constant@0,0"));
      await mode(ann, "mesh");
      await until(ann, () => globalThis.relightViewer.info?.name === "marble.prt");
      await ann.locator(".pin-mark").waitFor(PATIENCE);
      await ann.locator(".thread").waitFor(PATIENCE);
      assert.equal(await ann.getByText(/Placed on another model|cannot be placed/).count(), 0);
      await rests(ann);
      const anchor = JSON.parse(relight("room", "anchors", roomOf(ann), "--json"));
      assert.equal(anchor.state, "same");
      assert.equal(anchor.at.triangle, at.triangle ?? 0);
      // Its picture needs the model: where that is gone the thread says so, and so does the print.
      relight("unload", "early", "--forget", "--force");
      const bob = await enter(ann.url().replace(/#.*/, ""), "Bob");
      await bob.locator(".room-bar").waitFor(PATIENCE);
      await mode(bob, "mesh");
      await bob.locator(".pin-title").click();
      await bob
        .locator(".thread")
        .getByText(/This cannot be drawn: .*no such model/)
        .waitFor(PATIENCE);
      await shot(bob, "room-undrawn");
      await bob.evaluate(() => {
        globalThis.print = () => (globalThis.printed = true);
      });
      await bob.getByRole("button", { name: "Print" }).click();
      await until(bob, () => globalThis.printed);
      await bob.context().close();
      await ann.context().close();
    },
  };
}
