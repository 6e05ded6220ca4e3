// SPDX-License-Identifier: MIT
// One person's review: strokes on the surface, revisions compared and brought back, pins on a model
// that was replaced, variants, links to pins, a leader. For page.mjs.
import assert from "node:assert/strict";
import { people, roomOf } from "./people.mjs";

/** tools: as roomScenarios of rooms.mjs. */
export function reviewScenarios({ open, mode, settled, shot, axe, roomLog, PATIENCE }) {
  const { enter, create, rests, pin, focusIsOn } = people({ open, mode, PATIENCE });
  const begin = (home, name, title) =>
    create(home, "model=marble.prt&light=constant@0,0", name, title);

  return {
    async "strokes are drawn on the surface"(home) {
      const ann = await begin(home, "Ann", "Strokes");
      await pin(ann, "a dent", [340, 330]);
      await ann.locator(".stage").focus();
      await ann.keyboard.press("d");
      const camera = await ann.evaluate(() => globalThis.relightViewer.state.orbit.azimuth);
      await ann.mouse.move(300, 340);
      await ann.mouse.down();
      for (let i = 1; i <= 12; i++) await ann.mouse.move(300 + 8 * i, 340 + 20 * Math.sin(i));
      await ann.mouse.up();
      const kept = ann.locator(".strokes g polyline");
      await kept.first().waitFor({ ...PATIENCE, state: "attached" });
      assert.equal(
        await ann.evaluate(() => globalThis.relightViewer.state.orbit.azimuth),
        camera,
        "the hand that draws does not turn the camera",
      );
      await ann.keyboard.press("Escape");
      const strokes = roomLog(roomOf(ann)).filter(({ action }) => action.stroke);
      assert.equal(strokes.length, 1);
      const { points, pin: of } = strokes[0].action.stroke;
      assert.ok(points.length >= 10 && Number(of) > 0);
      for (const { position } of points) {
        const r = Math.hypot(position.x ?? 0, position.y ?? 0, position.z ?? 0);
        assert.ok(r > 0.5 && r < 1.5, `a point at ${r} from the middle`);
      }
      // On the picture of the pin, too; and it goes with its author's word.
      await ann.locator(".thread .over polyline").waitFor({ ...PATIENCE, state: "attached" });
      // Where the pin lies is on it: the mouse was at a share of the stage.
      const shares = await ann.evaluate(() => {
        const { left, top, width, height } = document
          .querySelector(".stage")
          .getBoundingClientRect();
        const mark = document.querySelector(".thread .over circle");
        return [
          (340 - left - width / 2) / height,
          (330 - top - height / 2) / height,
          (mark.cx.baseVal.value - 240) / 360,
          (mark.cy.baseVal.value - 180) / 360,
        ];
      });
      const [x, y, markedX, markedY] = shares;
      assert.ok(Math.hypot(markedX - x, markedY - y) < 0.02, String(shares));
      await shot(ann, "room-strokes");
      // Turned about, it lies on the other side.
      await ann.locator(".stage").focus();
      for (let i = 0; i < 30; i++) await ann.keyboard.press("ArrowLeft");
      await ann
        .locator(".strokes g polyline.behind")
        .first()
        .waitFor({
          ...PATIENCE,
          state: "attached",
        });
      await ann.locator(".pin-mark.behind").waitFor(PATIENCE);
      await ann.getByRole("button", { name: "Erase the last one" }).click();
      await kept.first().waitFor({ ...PATIENCE, state: "detached" });
      await ann.context().close();
    },

    async "a pin is written and read from any tab"(home) {
      const ann = await begin(home, "Ann", "Tabs");
      const light = () => ann.getByRole("tab", { name: "Light" }).click();
      await light();
      await pin(ann, `a dent ${"that is described at length ".repeat(8)}`, [340, 330]);
      await ann.locator(".thread img.seen").waitFor(PATIENCE);
      // Nothing is cut at the side of the panel.
      assert.deepEqual(
        await ann.locator(".tab-panel").evaluate((node) => {
          const right = node.getBoundingClientRect().right;
          const all = [...node.querySelectorAll(".section > *, .thread > *")];
          return all
            .filter((one) => one.getBoundingClientRect().right > right)
            .map((one) => one.outerHTML.slice(0, 80));
        }),
        [],
      );
      await light();
      await ann.locator(".pin-mark").click();
      await ann.locator(".thread").waitFor(PATIENCE);
      await light();
      await ann.locator(".stage").focus();
      await ann.keyboard.press("j");
      await ann.locator(".thread").waitFor(PATIENCE);
      const keys = ann.getByRole("button", { name: "Keys" });
      await keys.click();
      await ann.getByText("look around alone, back to all").waitFor(PATIENCE);
      await keys.click();
      assert.equal(await ann.locator(".keys").count(), 0);
      // The keys of a room are no text of a slider.
      await light();
      await ann.getByRole("slider", { name: "Turn" }).focus();
      await ann.keyboard.press("p");
      await ann.getByText("Click on the model where the pin goes.").waitFor(PATIENCE);
      await ann.context().close();
    },

    async "side by side, pins lie on the model of A"(home) {
      const ann = await begin(home, "Ann", "Beside");
      await ann.getByRole("tab", { name: "View", exact: true }).click();
      await ann.getByRole("button", { name: "Keep this as B" }).click();
      await ann.getByRole("radio", { name: "Side by side" }).click();
      await ann.waitForFunction(
        () => {
          const [pins, a] = [".pins-over", ".pane.a"].map((one) =>
            document.querySelector(one).getBoundingClientRect(),
          );
          return pins.left === a.left && Math.abs(pins.width - a.width) < 1;
        },
        null,
        { timeout: 30_000 },
      );
      await shot(ann, "room-beside");
      // The letters of the two are below the bar.
      const bar = await ann.locator(".room-bar").boundingBox();
      for (const letter of [".name-a", ".name-b"])
        assert.ok((await ann.locator(letter).boundingBox()).y >= bar.y + bar.height, letter);
      await ann.context().close();
    },

    async "an invitation and a decision that are pressed twice are one"(home) {
      const twice = (button) => button.evaluate((node) => [node.click(), node.click()]);
      const ann = await begin(home, "Ann", "Twice");
      await ann.getByRole("button", { name: "Invite" }).click();
      await twice(ann.getByRole("button", { name: /Make a link/ }));
      await ann.getByLabel("Invitation").waitFor(PATIENCE);
      await ann.getByRole("button", { name: "Close", exact: true }).click();
      await ann.getByRole("button", { name: "Approve", exact: true }).click();
      await twice(ann.getByRole("button", { name: "Approve this picture" }));
      await ann.getByText("approved as it is now").first().waitFor(PATIENCE);
      await rests(ann);
      const log = roomLog(roomOf(ann));
      assert.equal(log.filter(({ action }) => action.decide).length, 1);
      assert.equal(log.filter(({ action }) => action.invite).length, 1);
      await ann.context().close();
    },

    async "what opens takes the focus, Escape gives it back"(home) {
      const ann = await begin(home, "Ann", "Focus");
      const focused = () =>
        ann.evaluate(() => {
          const { activeElement: node } = document;
          return node.getAttribute("aria-label") ?? node.textContent.trim();
        });
      const opens = async (name, label) => {
        const button = ann.getByRole("button", { name });
        const words = await button.textContent();
        await button.focus();
        await ann.keyboard.press("Enter");
        await ann.waitForFunction(
          (one) => document.activeElement.getAttribute("aria-label") === one,
          label,
          PATIENCE,
        );
        await ann.keyboard.press("Tab");
        await ann.keyboard.press("Escape");
        await ann
          .getByLabel(label, { exact: true })
          .waitFor({ ...PATIENCE, state: "detached" });
        await ann.waitForTimeout(100);
        assert.equal(await focused(), words.trim());
      };
      await opens(/^Rooms/, "Rooms");
      await opens("Invite", "Invite");
      await ann.context().close();
    },

    async "on a phone a message lies below the bar, and a list of links is all there"(home) {
      const ann = await begin(home, "Ann", "Phone");
      await ann.setViewportSize({ width: 360, height: 640 });
      // A phone has no key P, but the button.
      await ann.getByText("No pin is here. Pin (or P) and a click").waitFor(PATIENCE);
      await ann.getByRole("button", { name: /^Undo/ }).click();
      const message = ann.getByText("There is no change of yours to undo here.");
      await message.waitFor(PATIENCE);
      await shot(ann, "room-phone");
      const over = await ann.locator(".notice").boundingBox();
      const bar = await ann.locator(".room-bar").boundingBox();
      assert.ok(over.y >= bar.y + bar.height, `${over.y} over ${bar.y + bar.height}`);
      await ann.getByRole("button", { name: "Close this message" }).click();
      await ann.getByRole("button", { name: "Invite" }).click();
      const made = ann.getByRole("button", { name: "Revoke the link of guest" });
      for (let i = 0; i < 4; i++) {
        await ann.getByRole("button", { name: /Make a link/ }).click();
        await made.nth(i).waitFor(PATIENCE);
      }
      await ann.getByRole("button", { name: "Close", exact: true }).click(); // scrolled to
      await made.first().waitFor({ ...PATIENCE, state: "detached" });
      await ann.context().close();
    },

    async "a second finger is no part of a stroke"(home) {
      const ann = await begin(home, "Ann", "Fingers");
      await pin(ann, "a dent", [340, 330]); // the surface is here
      await ann.locator(".stage").focus();
      await ann.keyboard.press("d");
      await ann.evaluate(() => {
        const finger = (kind, pointerId, x, y) =>
          document.elementFromPoint(300, 340).dispatchEvent(
            new PointerEvent(kind, {
              pointerId,
              isPrimary: pointerId === 101,
              pointerType: "touch",
              clientX: x,
              clientY: y,
              buttons: 1,
              bubbles: true,
            }),
          );
        finger("pointerdown", 101, 300, 340);
        for (let i = 1; i <= 5; i++) finger("pointermove", 101, 300 + 4 * i, 340);
        finger("pointerdown", 102, 360, 400);
        for (let i = 1; i <= 5; i++) finger("pointermove", 102, 360, 400 - 4 * i);
        finger("pointerup", 102, 360, 380);
        for (let i = 6; i <= 12; i++) finger("pointermove", 101, 300 + 4 * i, 340);
        finger("pointerup", 101, 348, 340);
      });
      const kept = ann.locator(".strokes g polyline");
      await kept.first().waitFor({ ...PATIENCE, state: "attached" });
      const strokes = roomLog(roomOf(ann)).filter(({ action }) => action.stroke);
      assert.equal(strokes.length, 1);
      assert.equal(strokes[0].action.stroke.points.length, 13);
      await ann.context().close();
    },

    async "revisions are compared and brought back"(home) {
      const ann = await begin(home, "Ann", "Revisions");
      const save = async (note) => {
        await rests(ann);
        await ann.getByLabel("Note of the revision").fill(note);
        await ann.getByRole("button", { name: "Save this as a revision" }).click();
        await ann.locator(".revisions li", { hasText: note }).waitFor(PATIENCE);
      };
      await save("as it came");
      const first = roomLog(roomOf(ann)).length;
      await ann.locator(".stage").focus();
      for (let i = 0; i < 8; i++) await ann.keyboard.press("ArrowLeft");
      await save("turned");
      assert.ok(roomLog(roomOf(ann)).length > first);
      assert.equal(await ann.locator(".revisions li").count(), 2);
      await ann
        .locator(".revisions li")
        .nth(1)
        .getByRole("button", { name: "Compare" })
        .click();
      const dialog = ann.getByRole("dialog", { name: "Two revisions" });
      await dialog.locator("img.seen").nth(1).waitFor(PATIENCE);
      const sources = await dialog
        .locator("img.seen")
        .evaluateAll((nodes) => nodes.map((node) => node.src));
      assert.notEqual(sources[0], sources[1]);
      await shot(ann, "room-compare");
      await dialog.getByRole("radio", { name: "Wipe" }).click();
      await dialog.getByRole("slider", { name: "Wipe" }).fill("30");
      await shot(ann, "room-wipe");
      await dialog.getByRole("radio", { name: "ΔE map" }).click();
      const words = dialog.getByText(/ΔE₀₀ mean/);
      await words.waitFor(PATIENCE);
      assert.ok(Number(/mean ([\d.]+)/.exec(await words.textContent())[1]) > 0.1);
      await shot(ann, "room-difference");
      // The keys of the room rest, and so does the page behind.
      await ann.keyboard.press("p");
      await ann.keyboard.press("a");
      assert.equal(await ann.getByText("Click on the model where the pin goes.").count(), 0);
      assert.equal(
        await ann.locator(".room-bar button", { hasText: "Back to all" }).count(),
        0,
      );
      const behind = ann.locator(".room-bar button", { hasText: "Look alone" });
      assert.ok(await behind.evaluate((node) => node.closest("[inert]") !== null));
      // A revision with itself.
      await dialog.getByLabel("B", { exact: true }).selectOption("1");
      await dialog.getByText(/ΔE₀₀ mean 0\.00, most 0\.0/).waitFor(PATIENCE);
      await ann.evaluate(axe);
      const found = await ann.evaluate(() =>
        globalThis.axe.run({ runOnly: ["wcag2a", "wcag2aa"] }),
      );
      assert.deepEqual(
        found.violations.map((one) => `${one.id}: ${one.nodes[0].html}`),
        [],
      );
      await ann.keyboard.press("Escape");
      await dialog.waitFor({ ...PATIENCE, state: "detached" });
      await focusIsOn(ann, "Compare");
      await ann
        .locator(".revisions li")
        .nth(1)
        .getByRole("button", { name: "Bring back" })
        .click();
      await ann.getByText("Revision 1, as it is now").waitFor(PATIENCE);

      // Variants: a medium by name.
      await ann.getByRole("tab", { name: "Review" }).click();
      await ann.evaluate(() => globalThis.relightRoom.rests());
      await ann.context().close();
    },

    async "pins keep their place on a model that was replaced"(home) {
      const ann = await begin(home, "Ann", "Replaced");
      await pin(ann, "stays", [260, 380]);
      await pin(ann, "goes", [540, 352]);
      assert.equal(await ann.locator(".pin-mark").count(), 2);
      const show = async (model) => {
        await ann.evaluate((hash) => (location.hash = hash), `model=${model}`);
        await ann.waitForFunction(
          (name) =>
            globalThis.relightViewer.status.mode === "mesh" &&
            globalThis.relightViewer.info?.name === name,
          model,
          PATIENCE,
        );
      };
      // The same shape in another bake: the same triangles.
      await show("open.prt");
      await ann.waitForFunction(
        () => document.querySelectorAll(".pin-mark").length === 2,
        null,
        PATIENCE,
      );
      await ann.locator(".pin-title", { hasText: "stays" }).click();
      assert.equal(await ann.getByText(/Placed on another model|cannot be placed/).count(), 0);
      await show("shorter.prt");
      await ann.getByText(/Placed on another model: the nearest surface is/).waitFor(PATIENCE);
      await ann.waitForFunction(
        () => document.querySelectorAll(".pin-mark").length === 1,
        null,
        PATIENCE,
      );
      await ann.locator(".pin-title", { hasText: "goes" }).click();
      await ann.getByText(/It cannot be placed on this model/).waitFor(PATIENCE);
      await settled(ann);
      await shot(ann, "room-replaced");

      // A link to the pin, in another browser.
      await ann.getByRole("button", { name: "Link to this pin" }).click();
      const link = await ann.evaluate(() => navigator.clipboard.readText());
      const bob = await enter(link, "Bob");
      await bob.locator(".thread").getByText("goes").waitFor(PATIENCE);
      await bob.locator(".thread img.seen").waitFor(PATIENCE);
      // Ann leads: Bob takes her camera, until he stops it.
      await mode(bob, "mesh");
      await ann.getByTitle(/^Bob, /).waitFor(PATIENCE);
      await ann.locator(".stage").focus();
      await ann.keyboard.press("a");
      await ann.keyboard.press("a");
      await ann.keyboard.press("l");
      await bob.getByText("The camera is Ann’s.").waitFor(PATIENCE);
      await ann.getByTitle(/^Bob, .*follows you/).waitFor(PATIENCE);
      for (let i = 0; i < 5; i++) await ann.keyboard.press("ArrowLeft");
      const azimuth = await ann.evaluate(() => globalThis.relightViewer.state.orbit.azimuth);
      await bob.waitForFunction(
        (one) => Math.abs(globalThis.relightViewer.state.orbit.azimuth - one) < 0.1,
        azimuth,
        PATIENCE,
      );
      await ann.keyboard.press("l");
      await bob.getByText("The camera is Ann’s.").waitFor({ ...PATIENCE, state: "detached" });
      await bob.context().close();
      await ann.context().close();
    },
  };
}
