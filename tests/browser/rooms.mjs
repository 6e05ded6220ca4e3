// SPDX-License-Identifier: MIT
// Two browsers in one review room: what one does the other sees, and how soon. For page.mjs, which
// brings the daemon and the browser. Nothing fails by speed; the times are printed.
import assert from "node:assert/strict";
import { people, placePin } from "./people.mjs";

// The times at which a page showed a turn of its first lamp.
const watchTurns = (page) =>
  page.evaluate(() => {
    const v = globalThis.relightViewer;
    globalThis.turns = [];
    const show = v.show.bind(v);
    let last = null;
    v.show = (state) => {
      const turn = state.lamps[0].rotate.toFixed(3);
      if (turn !== last) globalThis.turns.push([turn, Date.now()]);
      last = turn;
      show(state);
    };
  });
const turnOf = (page) => page.evaluate(() => globalThis.relightViewer.state.lamps[0].rotate);

// Until both show the same light: either may still be told of the other's last step.
async function agree(a, b) {
  const end = Date.now() + 120_000;
  while (Math.abs((await turnOf(a)) - (await turnOf(b))) > 1e-3) {
    assert.ok(Date.now() < end, `${await turnOf(a)} and ${await turnOf(b)} degrees`);
    await a.waitForTimeout(50);
  }
}

// The link goes down, and stays so until connect.
async function disconnect(page) {
  await page.evaluate(() => {
    const { client } = globalThis.relightViewer;
    client.connect = () => undefined;
    client.socket.close();
  });
  await page.getByText("Offline", { exact: true }).first().waitFor({ timeout: 120_000 });
}
const connect = (page) =>
  page.evaluate(() => {
    const { client } = globalThis.relightViewer;
    delete client.connect;
    client.connect();
  });

// A hand with Shift turns the light; it presses at the middle and moves to the right.
async function drag(page, steps) {
  await page.locator(".stage").focus();
  await page.keyboard.down("Shift");
  await page.mouse.move(300, 380);
  await page.mouse.down();
  for (let i = 1; i <= steps; i++) {
    await page.mouse.move(300 + 3 * i, 380);
    await page.waitForTimeout(40);
  }
  await page.mouse.up();
  await page.keyboard.up("Shift");
}

// Milliseconds between two frames while the page draws as fast as it can: the median.
const drawingTime = (page) =>
  page.evaluate(async () => {
    const v = globalThis.relightViewer;
    const times = [];
    for (let i = 0; i < 12; i++) {
      const begin = performance.now();
      v.show({ ...v.state, exposure: v.state.exposure + (i % 2 ? -0.01 : 0.01) });
      await new Promise((resolve) => requestAnimationFrame(() => setTimeout(resolve, 0)));
      times.push(performance.now() - begin);
    }
    return Math.round(times.sort((a, b) => a - b)[6]);
  });

// Until nothing of this page is on its way and its hand rests.
async function settles(page) {
  await page.waitForTimeout(400);
  await page.waitForFunction(() => globalThis.relightRoom?.rests(), null, { timeout: 120_000 });
}

function quantile(values, share) {
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))];
}

/** tools: open, mode, shot, axe, roomLog, PATIENCE of page.mjs. */
export function roomScenarios({ open, mode, shot, axe, roomLog, PATIENCE }) {
  const sceneEvents = (room) => roomLog(room).filter(({ action }) => action.scene);
  const { enter, create, join, inRoom, focusIsOn } = people({ open, mode, PATIENCE });

  return {
    async "two people review in a room"(home) {
      const ann = await create(
        home,
        "model=marble.prt&light=page:studio@20,0",
        "Ann",
        "Bumps in marble",
      );
      const link = ann.url();
      const room = /room=([0-9a-f]{32})/.exec(link)[1];
      assert.match(link, /\?room=[0-9a-f]{32}/);
      const bob = await join(ann, "Bob Stone");
      await ann.getByTitle(/^Bob Stone, /).waitFor(PATIENCE);
      await bob.getByTitle(/^Ann, /).waitFor(PATIENCE);

      // Pins: from Ann's click to Bob's list.
      const pins = [];
      for (let i = 0; i < 6; i++) {
        await bob.evaluate((n) => {
          globalThis.seen = new Promise((resolve) => {
            const look = () => {
              if (document.querySelectorAll(".pin-row").length > n) resolve(Date.now());
              else setTimeout(look, 2);
            };
            look();
          });
        }, i);
        const begin = await placePin(ann, `spot ${i}, @Bob`, [
          330 + 20 * i,
          360 + 12 * (i % 3),
        ]);
        pins.push((await bob.evaluate(() => globalThis.seen)) - begin);
      }
      console.log(
        `     a pin is in the other browser after ${quantile(pins, 0.5)} ms (median), ${quantile(pins, 0.95)} ms (p95; goal 300)`,
      );
      assert.equal(await bob.locator(".pin-mark").count(), 6);
      await bob.locator(".pin-title").first().click();
      await bob.getByLabel("Reply").fill("I see it");
      await bob.keyboard.press("Control+Enter");
      await ann.locator(".pin-title").first().click();
      await ann.getByText("I see it").waitFor(PATIENCE);
      assert.ok((await ann.locator(".pin-row .unread").count()) >= 1, "Bob's note is unread");
      await bob.locator("img.seen").first().waitFor(PATIENCE);
      await shot(ann, "room");

      // A light drag: each step's time in both browsers. It goes by presence; the log has its end.
      const before_drag = sceneEvents(room).length;
      await watchTurns(ann);
      await watchTurns(bob);
      await drag(ann, 50);
      const last = (await turnOf(ann)).toFixed(3);
      await bob.waitForFunction(
        (turn) => globalThis.turns.some(([one]) => one === turn),
        last,
        PATIENCE,
      );
      const sent = new Map(await ann.evaluate(() => globalThis.turns));
      const drags = (await bob.evaluate(() => globalThis.turns))
        .filter(([turn]) => sent.has(turn))
        .map(([turn, ms]) => ms - sent.get(turn));
      assert.ok(drags.length > 10, `${drags.length} steps of the drag came over`);
      console.log(
        `     a light drag is there after ${quantile(drags, 0.5)} ms (median), ${quantile(drags, 0.95)} ms (p95; goal 150), ${drags.length} of ${sent.size} steps`,
      );
      console.log(
        `     of which the other page's own drawing: ${await drawingTime(bob)} ms a frame`,
      );
      await settles(ann);
      const edits = sceneEvents(room).length - before_drag;
      // The hand rests where a slow machine leaves 250 ms between two steps.
      const at = [...sent.values()];
      const rests = 1 + at.filter((ms, i) => i && ms - at[i - 1] > 150).length;
      assert.ok(edits >= 1 && edits <= rests + 1, `${edits} edits for ${rests} rests`);

      // Alone, and back to all.
      await bob.locator(".stage").focus();
      await bob.keyboard.press("a");
      const before = await turnOf(bob);
      await ann.keyboard.press("Shift+ArrowLeft");
      await ann.getByTitle(/Bob Stone, .*looks around alone/).waitFor(PATIENCE);
      await bob.waitForTimeout(500);
      assert.equal(await turnOf(bob), before);
      await bob.keyboard.press("a");
      await agree(ann, bob);
      // Ann's own step back, for both.
      const turned = await turnOf(bob);
      await ann.getByRole("button", { name: /^Undo/ }).click();
      await bob.waitForFunction(
        (turn) => Math.abs(globalThis.relightViewer.state.lamps[0].rotate - turn) > 1e-3,
        turned,
        PATIENCE,
      );

      // Status, filters, a decision and what came after it.
      await ann.getByRole("button", { name: "Resolve" }).click();
      await bob.waitForFunction(
        () => document.querySelectorAll(".pin-row").length === 5,
        null,
        PATIENCE,
      );
      await bob.getByRole("radio", { name: "Resolved" }).click();
      assert.equal(await bob.locator(".pin-row").count(), 1);
      await bob.getByRole("radio", { name: "Mine" }).click();
      assert.equal(await bob.locator(".pin-row").count(), 6); // all mention him
      await ann.getByLabel("Note of the decision").fill("as agreed");
      await ann.getByRole("button", { name: "Approve", exact: true }).click();
      await ann.getByAltText("What the decision is about").waitFor(PATIENCE);
      await ann.getByRole("button", { name: "Approve this picture" }).click();
      await bob.getByText("approved as it is now").waitFor(PATIENCE);
      await bob.locator(".stage").focus();
      await bob.keyboard.press("Shift+ArrowRight");
      await ann.getByText(/approved at revision \d+, changed since/).waitFor(PATIENCE);
      await ann.getByText(/ΔE₀₀ mean \d/).waitFor(PATIENCE);

      // A guest by link looks, and may not pin.
      await ann.getByRole("button", { name: "Invite" }).click();
      await ann.getByLabel("May").selectOption({ label: "look" });
      await ann.getByRole("button", { name: /Make a link/ }).click();
      const invitation = await ann.getByLabel("Invitation").inputValue();
      const guest = await enter(invitation, "Guest");
      await inRoom(guest);
      await mode(guest, "mesh");
      assert.equal(await guest.getByRole("button", { name: "Pin", exact: true }).count(), 0);
      assert.equal(await guest.getByText("Not permitted").count(), 0);
      assert.ok(!guest.url().includes("relight_"), "the secret stays in the address");
      // Revoked, the link is dead and the guest leaves the room.
      await ann.getByRole("button", { name: "Revoke the link of guest" }).click();
      await guest.locator(".room-bar").waitFor({ ...PATIENCE, state: "detached" });
      await guest.getByText(/is not valid any more|no member of this room/).waitFor(PATIENCE);
      const late = await enter(invitation, "Guest");
      await late.getByText(/this invitation is not valid: it was revoked/).waitFor(PATIENCE);
      await late.context().close();
      await guest.context().close();
      await ann.getByRole("button", { name: "Close", exact: true }).click();

      await ann.evaluate(axe);
      const found = await ann.evaluate(() =>
        globalThis.axe.run({ runOnly: ["wcag2a", "wcag2aa"] }),
      );
      assert.deepEqual(
        found.violations.map((one) => `${one.id}: ${one.nodes[0].html}`),
        [],
      );

      // On paper.
      await ann.evaluate(() => {
        globalThis.print = () => (globalThis.printed = true);
      });
      await ann.getByRole("button", { name: "Print" }).click();
      await ann.waitForFunction(() => globalThis.printed, null, PATIENCE);
      assert.equal(await ann.locator(".print section").count(), 7);
      await ann.emulateMedia({ media: "print" });
      await shot(ann, "room-print");
      await ann.emulateMedia({ media: null });
      await ann.keyboard.press("a"); // the keys of the room rest
      assert.equal(
        await ann.locator(".room-bar button", { hasText: "Back to all" }).count(),
        0,
      );
      await ann.keyboard.press("Escape");
      await ann.locator(".print").waitFor({ ...PATIENCE, state: "detached" });
      await focusIsOn(ann, "Print");
      await ann.getByRole("button", { name: "Look alone" }).waitFor(PATIENCE);

      await ann.context().close();
      await bob.context().close();
    },

    // What was done offline is done once, and a conflict is told.
    async "a room after a lost connection"(home) {
      const ann = await create(home, "model=marble.prt&light=constant@0,0", "Ann", "Offline");
      const bob = await join(ann, "Bob");
      await disconnect(bob);
      await bob.locator(".stage").focus();
      await bob.keyboard.press("Shift+ArrowRight");
      await ann.locator(".stage").focus();
      await ann.keyboard.press("Shift+ArrowLeft");
      await ann.waitForTimeout(600);
      await connect(bob);
      await bob.getByText(/another person changed the same part/).waitFor(PATIENCE);
      await agree(ann, bob);

      // A model that was chosen offline is everybody's afterwards.
      await disconnect(bob);
      await bob.evaluate(() => (location.hash = "model=open.prt"));
      await connect(bob);
      for (const one of [bob, ann])
        await one.waitForFunction(
          () => globalThis.relightViewer.info?.name === "open.prt",
          null,
          PATIENCE,
        );
      await agree(ann, bob);
      await ann.context().close();
      await bob.context().close();
    },

    // The scene of before the room is that person's own.
    async "Back leaves a room"(home) {
      const ann = await create(home, "model=marble.prt&light=constant@20,0", "Ann", "Back");
      const room = /room=([0-9a-f]{32})/.exec(ann.url())[1];
      const bob = await join(ann, "Bob");
      await ann.locator(".stage").focus();
      for (let i = 0; i < 3; i++) {
        await ann.keyboard.press("Shift+ArrowRight");
        await settles(ann);
      }
      await agree(ann, bob);
      const turned = await turnOf(bob);
      const before = sceneEvents(room).length;
      await ann.goBack();
      await ann.locator(".room-bar").waitFor({ ...PATIENCE, state: "detached" });
      assert.ok(!ann.url().includes("room="));
      await ann.getByRole("tab", { name: "Light", selected: true }).waitFor(PATIENCE);
      assert.equal(await turnOf(ann), 20);
      await settles(ann);
      assert.equal(await turnOf(bob), turned);
      assert.equal(sceneEvents(room).length, before);
      await ann.goForward();
      await inRoom(ann);
      await agree(ann, bob);
      assert.equal(await turnOf(bob), turned);
      await ann.context().close();
      await bob.context().close();
    },
  };
}
