// SPDX-License-Identifier: MIT
// The picture, and the hands on it.
import { useEffect, useRef } from "preact/hooks";
import { attachGestures } from "../scene/gestures";
import { Viewer } from "../scene/viewer";
import { environmentName } from "./light-panel";
import {
  client,
  commit,
  fault,
  fine,
  info,
  medium,
  resetOrbit,
  scene,
  setOrbit,
  status,
  turnLight,
  useViewer,
} from "./store";

function hasWebGL2(): boolean {
  if (new URLSearchParams(location.search).has("no-webgl")) return false;
  const context = document.createElement("canvas").getContext("webgl2");
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return context !== null;
}

/** What is shown, in a sentence for screen readers. */
export function description(): string {
  const { orbit, lamps, exposure } = scene.value;
  const name = info.value?.name || info.value?.model.slice(0, 8);
  if (!name) return "No model is shown.";
  const lights = lamps.map(
    (lamp) => `${environmentName(lamp.env)}, turned ${Math.round(lamp.rotate)} degrees`,
  );
  return (
    `${name}${medium.value?.name ? ` in ${medium.value.name}` : ""}, lit by ${lights.join(" and ")}, ` +
    `seen from azimuth ${Math.round(orbit.azimuth)} and elevation ${Math.round(orbit.elevation)} degrees` +
    `${exposure ? `, exposure ${exposure} EV` : ""}.`
  );
}

export function StageView() {
  const host = useRef<HTMLDivElement>(null);
  const canvas = useRef<HTMLCanvasElement>(null);
  const picture = useRef<HTMLCanvasElement>(null);
  useEffect(() => {
    const box = host.current;
    if (!box || !canvas.current || !picture.current) return undefined;
    const nodes = { canvas: canvas.current, pictureCanvas: picture.current };
    let viewer: Viewer | null = null;
    let observer: ResizeObserver | null = null;
    void makeViewer(nodes).then((made) => {
      viewer = made;
      observer = new ResizeObserver(() => made.resized());
      observer.observe(box);
      made.resized();
      useViewer(made);
      Object.assign(globalThis, { relightViewer: made }); // for tests and for the console
    });
    const detach = attachGestures(box, {
      orbit: () => scene.value.orbit,
      setOrbit,
      turnLight,
      reset: resetOrbit,
      commit,
    });
    return () => {
      detach();
      observer?.disconnect();
      viewer?.close();
    };
  }, []);
  return (
    <div
      ref={host}
      class="stage"
      tabIndex={0}
      role="application"
      aria-label="Model"
      aria-describedby="stage-help stage-text"
    >
      <canvas ref={canvas} class="gl" aria-hidden="true" />
      <canvas ref={picture} class="picture" aria-hidden="true" hidden />
      <p id="stage-text" class="for-readers" aria-live="polite">
        {description()}
      </p>
      <p id="stage-help" class="for-readers">
        Arrow keys turn the model, with Shift the light, with Alt they move it. Plus and minus
        magnify, 0 goes back.
      </p>
    </div>
  );
}

async function makeViewer(nodes: {
  canvas: HTMLCanvasElement;
  pictureCanvas: HTMLCanvasElement;
}): Promise<Viewer> {
  const { Stage } = await import("../scene/stage");
  let stage: InstanceType<typeof Stage> | null = null;
  if (hasWebGL2()) {
    try {
      stage = new Stage(nodes.canvas);
    } catch {
      stage = null; // pictures of the daemon instead
    }
  }
  return new Viewer(client, nodes, stage, {
    status: (value) => (status.value = value),
    info: (value) => (info.value = value),
    fault,
    fine,
  });
}
