// SPDX-License-Identifier: MIT
// The picture, and the hands on it.
import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import type { ModelInfo } from "../gen/relight_pb";
import { attachGestures } from "../scene/gestures";
import type { Status, Viewer } from "../scene/viewer";
import { CompareStage } from "./compare";
import { environmentName } from "./light-panel";
import { makeViewer } from "./make-viewer";
import {
  commit,
  info,
  medium,
  resetOrbit,
  scene,
  setOrbit,
  status,
  turnLight,
  useViewer,
} from "./store";

/** What is shown, in a sentence for screen readers. */
export function description(): string {
  const { orbit, lamps, exposure, compare } = scene.value;
  const name = info.value?.name || info.value?.model.slice(0, 8);
  if (!name) return "No model is shown.";
  const lights = lamps.map(
    (lamp) => `${environmentName(lamp.env)}, turned ${Math.round(lamp.rotate)} degrees`,
  );
  return (
    `${name}${medium.value?.name ? ` in ${medium.value.name}` : ""}, lit by ${lights.join(" and ")}, ` +
    `${compare ? "compared with another state, " : ""}seen from azimuth ${Math.round(orbit.azimuth)} and elevation ${Math.round(orbit.elevation)} degrees` +
    `${exposure ? `, exposure ${exposure} EV` : ""}.`
  );
}

const REST_MS = 600; // a text is read out when what it is of has rested for so long
function useRested(text: string): string {
  const rested = useSignal(text);
  useEffect(() => {
    const timer = setTimeout(() => (rested.value = text), REST_MS);
    return () => clearTimeout(timer);
  }, [text]);
  return rested.value;
}

export function StageView() {
  const host = useRef<HTMLDivElement>(null);
  const canvas = useRef<HTMLCanvasElement>(null);
  const picture = useRef<HTMLCanvasElement>(null);
  const pane = useRef<HTMLDivElement>(null);
  const { compare } = scene.value;
  const text = useRested(description());
  useEffect(() => {
    const box = host.current;
    const mine = pane.current;
    if (!box || !mine || !canvas.current || !picture.current) return undefined;
    const nodes = { canvas: canvas.current, pictureCanvas: picture.current };
    let viewer: Viewer | null = null;
    let observer: ResizeObserver | null = null;
    const events = {
      status: (value: Status) => (status.value = value),
      info: (value: ModelInfo | null) => (info.value = value),
    };
    void makeViewer(nodes, events).then((made) => {
      viewer = made;
      observer = new ResizeObserver(() => made.resized());
      observer.observe(mine);
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
      busy: () => viewer?.busy ?? false,
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
      class={`stage ${compare?.mode ?? ""}`}
      style={{ "--at": `${100 * (compare?.at ?? 1)}%` }}
      tabIndex={0}
      role="application"
      aria-label="Model"
      aria-describedby="stage-help stage-text"
    >
      <div ref={pane} class="pane a">
        <canvas ref={canvas} class="gl" aria-hidden="true" />
        <canvas ref={picture} class="picture" aria-hidden="true" hidden />
      </div>
      {compare && <CompareStage />}
      <p id="stage-text" class="for-readers" aria-live="polite">
        {text}
      </p>
      <p id="stage-help" class="for-readers">
        Arrow keys turn the model, with Shift the light, with Alt they move it. Plus and minus
        magnify, 0 goes back.
      </p>
    </div>
  );
}
