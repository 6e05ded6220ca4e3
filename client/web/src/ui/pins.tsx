// SPDX-License-Identifier: MIT
// Pins and other people's cursors over the picture. With pinMode a click on the model places one.
import { useEffect, useRef } from "preact/hooks";
import { useSignal } from "@preact/signals";
import type { SurfacePoint } from "../gen/relight_pb";
import type { Vec3 } from "../scene/camera";
import { pick, project, type Point } from "../room/pick";
import { css, colorOf, others, state, tell } from "../room/session";
import { newPin, openPin, pinLabel, pinMode, shownPins } from "./review-panel";
import { fault, info, scene, status, viewer } from "./store";

function pointUnder(event: PointerEvent | MouseEvent, box: DOMRect): Point | null {
  const mesh = viewer?.shape;
  if (!mesh || !viewer) return null;
  const [x, y] = [event.clientX - box.left, event.clientY - box.top];
  return pick(mesh, viewer.placed(scene.value), x, y, box.width, box.height);
}

// Where a point is on the screen, in shares of its size; null: behind the eye or not kept.
function placeOf(at: SurfacePoint | undefined, size: { w: number; h: number }) {
  const p = at?.position;
  if (!p || !viewer?.framed) return null;
  const position: Vec3 = [p.x, p.y, p.z];
  return project(viewer.placed(scene.value), position, size.w, size.h);
}

export function Pins() {
  const host = useRef<HTMLDivElement>(null);
  const size = useSignal({ w: 1, h: 1 });
  useEffect(() => {
    const box = host.current;
    const stage = box?.parentElement;
    if (!box || !stage) return undefined;
    const observer = new ResizeObserver(
      () => (size.value = { w: box.clientWidth, h: box.clientHeight }),
    );
    observer.observe(box);
    const stop = new AbortController();
    const { signal } = stop;
    let told = 0;
    stage.addEventListener(
      "pointermove",
      (event) => {
        if (event.buttons || performance.now() - told < 100 || !state.value) return;
        told = performance.now();
        tell({ cursor: pointUnder(event, box.getBoundingClientRect()) });
      },
      { signal },
    );
    // Before the gestures of the stage.
    stage.addEventListener(
      "pointerdown",
      (event) => {
        if (!pinMode.value || event.button !== 0) return;
        if (!(event.target instanceof Element) || !event.target.closest(".stage")) return;
        event.preventDefault();
        event.stopPropagation();
        const point = pointUnder(event, box.getBoundingClientRect());
        if (point) {
          newPin.value = point;
          pinMode.value = false;
        } else if (!viewer?.shape)
          fault(new Error("the daemon draws this model: pins go onto models with a bake"));
      },
      { signal, capture: true },
    );
    return () => {
      observer.disconnect();
      stop.abort();
    };
  }, []);
  void scene.value.orbit;
  void info.value;
  void status.value.mode;
  const now = size.value;
  const isHere = (model: string | undefined) => model === state.value?.scene?.model;
  return (
    <div ref={host} class={`pins-over ${pinMode.value ? "placing" : ""}`}>
      {shownPins.value.map((pin) => {
        const number = pin.stamp?.sequence ?? 0n;
        const at = isHere(pin.seen?.model) ? placeOf(pin.at, now) : null;
        if (!at) return null;
        return (
          <button
            key={String(number)}
            type="button"
            class={`pin-mark ${pin.resolved ? "resolved" : ""}`}
            aria-pressed={openPin.value === number}
            aria-label={`Pin ${pinLabel(number)}: ${pin.notes[0]?.text ?? ""}`}
            style={{ left: `${at.x}px`, top: `${at.y}px` }}
            onClick={() => (openPin.value = number)}
          >
            {pinLabel(number)}
          </button>
        );
      })}
      {others.value.map((person) => {
        const at = placeOf(person.cursor, now);
        if (!at) return null;
        return (
          <span
            key={String(person.key)}
            class="cursor"
            style={{
              left: `${at.x}px`,
              top: `${at.y}px`,
              "--own": css(person.color || colorOf(person.key)),
            }}
          >
            {person.name || person.by}
          </span>
        );
      })}
      {pinMode.value && (
        <p class="placing-hint" role="status">
          Click on the model where the pin goes. Esc stops.
        </p>
      )}
    </div>
  );
}
