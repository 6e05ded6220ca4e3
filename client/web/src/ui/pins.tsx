// SPDX-License-Identifier: MIT
// Pins, strokes and other people's cursors over the picture. With a tool in the hand a press on the
// model places a pin or draws.
import type { ComponentChildren } from "preact";
import { useEffect, useRef } from "preact/hooks";
import { useSignal } from "@preact/signals";
import type { Participant, SurfacePoint } from "../gen/relight_pb";
import { PageError } from "../protocol/errors";
import type { Placed, Vec3 } from "../scene/camera";
import { facesAway, type Anchor } from "../room/anchor";
import { anchors, lines } from "../room/anchored";
import { colorOf, css, me, others, state } from "../room/here";
import { pick, project, type Point } from "../room/pick";
import { tell } from "../room/presence";
import {
  askAbout,
  drawn,
  openPin,
  openThread,
  pinLabel,
  shownPins,
  tool,
} from "./review-state";
import { WIDTH_PX, ownStrokes, sendStroke } from "./strokes";
import { fault, info, scene, status, viewer } from "./store";

const MOST_POINTS = 2000; // of a stroke
const STEP_PX = 3;

interface Size {
  w: number;
  h: number;
}
function pointUnder(event: PointerEvent, box: DOMRect): Point | null {
  const mesh = viewer?.shape;
  if (!mesh || !viewer) return null;
  const [x, y] = [event.clientX - box.left, event.clientY - box.top];
  return pick(mesh, viewer.placed(scene.value), x, y, box.width, box.height);
}

const noSurface = () =>
  fault(new PageError("The model's surface is not here yet.", "Try it again in a moment."));

function place(event: PointerEvent, box: DOMRect): void {
  const point = pointUnder(event, box);
  if (point) {
    askAbout(point);
    tool.value = "none";
  } else if (!viewer?.shape) noSurface();
}

function finishStroke(): void {
  if (drawn.value.length > 1) void sendStroke(drawn.value, openPin.value ?? 0n);
  drawn.value = [];
}

// From a press to its end, by one pointer; leaves the surface where it must.
function draw(event: PointerEvent, host: HTMLElement): void {
  const box = host.getBoundingClientRect();
  const stop = new AbortController();
  const { signal: over } = stop;
  let last = { x: -1e9, y: -1e9 };
  const isOther = ({ pointerId }: PointerEvent) => pointerId !== event.pointerId;
  const add = (at: PointerEvent) => {
    if (isOther(at) || Math.hypot(at.clientX - last.x, at.clientY - last.y) < STEP_PX) return;
    const point = drawn.value.length < MOST_POINTS ? pointUnder(at, box) : null;
    if (!point) return;
    last = { x: at.clientX, y: at.clientY };
    drawn.value = [...drawn.value, point];
  };
  if (!viewer?.shape) {
    noSurface();
    return;
  }
  drawn.value = [];
  add(event);
  addEventListener("pointermove", add, { signal: over });
  const end = (at: PointerEvent) => {
    if (isOther(at)) return;
    stop.abort();
    finishStroke();
  };
  addEventListener("pointerup", end, { signal: over });
  addEventListener("pointercancel", end, { signal: over });
}

function useHands(host: { current: HTMLDivElement | null }, size: { value: Size }): void {
  useEffect(() => {
    const box = host.current;
    const stage = box?.parentElement;
    if (!box || !stage) return undefined;
    const observer = new ResizeObserver(
      () => (size.value = { w: box.clientWidth, h: box.clientHeight }),
    );
    observer.observe(box);
    const stop = new AbortController();
    const { signal: over } = stop;
    let told = 0;
    stage.addEventListener(
      "pointermove",
      (event) => {
        if (event.buttons || performance.now() - told < 100 || !state.value) return;
        told = performance.now();
        tell({ cursor: pointUnder(event, box.getBoundingClientRect()) });
      },
      { signal: over },
    );
    stage.addEventListener("pointerleave", () => tell({ cursor: null }), { signal: over });
    // Before the gestures of the stage.
    stage.addEventListener(
      "pointerdown",
      (event) => {
        if (tool.value === "none" || event.button !== 0) return;
        if (!(event.target instanceof Element) || !event.target.closest(".stage")) return;
        event.preventDefault();
        event.stopPropagation();
        if (!event.isPrimary) return; // another finger
        if (tool.value === "pin") place(event, box.getBoundingClientRect());
        else draw(event, box);
      },
      { signal: over, capture: true },
    );
    return () => {
      observer.disconnect();
      stop.abort();
    };
  }, []);
}

// ---- what is over the picture

const positionOf = (at: SurfacePoint | undefined): Vec3 | null =>
  at?.position ? [at.position.x, at.position.y, at.position.z] : null;

// Runs of points on the screen, those that face the eye apart from those that face away.
function runsOf(points: readonly Anchor[], placed: Placed, size: Size) {
  const runs: { behind: boolean; points: string[] }[] = [];
  let broken = true;
  for (const point of points) {
    const at = point.state === "lost" ? null : project(placed, point.position, size.w, size.h);
    if (!at) {
      broken = true;
      continue;
    }
    const behind = facesAway(point, placed.eye);
    const text = `${at.x.toFixed(1)},${at.y.toFixed(1)}`;
    const last = runs.at(-1);
    if (!last || broken) runs.push({ behind, points: [text] });
    else {
      last.points.push(text);
      if (last.behind !== behind) runs.push({ behind, points: [text] });
    }
    broken = false;
  }
  return runs;
}

function Strokes({ placed, size }: { placed: Placed; size: Size }) {
  const own = [{ points: drawn.value, refused: false }, ...ownStrokes()].map((stroke) => ({
    refused: stroke.refused,
    points: stroke.points.flatMap(({ position }) => {
      const at = project(placed, position, size.w, size.h);
      return at ? [`${at.x.toFixed(1)},${at.y.toFixed(1)}`] : [];
    }),
  }));
  return (
    <svg class="strokes" aria-hidden="true">
      {lines.value.map(({ stroke, points }) => (
        <g
          key={String(stroke.stamp?.sequence)}
          stroke={css(stroke.line?.color ?? 0)}
          stroke-width={stroke.line?.width ?? WIDTH_PX}
          class={stroke.line?.pin && stroke.line.pin === openPin.value ? "open" : ""}
        >
          {runsOf(points, placed, size).map((run, i) => (
            <polyline
              key={i}
              points={run.points.join(" ")}
              class={run.behind ? "behind" : ""}
            />
          ))}
        </g>
      ))}
      {own.map(
        ({ points, refused }, i) =>
          points.length > 1 && (
            <polyline
              key={i}
              points={points.join(" ")}
              stroke={css(colorOf(me.value))}
              stroke-width={WIDTH_PX}
              class={refused ? "refused" : ""}
            />
          ),
      )}
    </svg>
  );
}

function Marks({ placed, size }: { placed: Placed; size: Size }): ComponentChildren {
  return shownPins.value.map((pin) => {
    const number = pin.stamp?.sequence ?? 0n;
    const anchor = anchors.value.get(number);
    if (!anchor || anchor.state === "lost") return null;
    const at = project(placed, anchor.position, size.w, size.h);
    if (!at) return null;
    return (
      <button
        key={String(number)}
        type="button"
        class={`pin-mark ${pin.resolved ? "resolved" : ""} ${
          facesAway(anchor, placed.eye) ? "behind" : ""
        }`}
        aria-pressed={openPin.value === number}
        aria-label={`Pin ${pinLabel(number)}: ${pin.notes[0]?.text ?? ""}`}
        style={{ left: `${at.x}px`, top: `${at.y}px` }}
        onClick={() => openThread(number)}
      >
        {pinLabel(number)}
      </button>
    );
  });
}

// The model that a person points at.
const modelOf = (person: Participant) =>
  (person.alone ? person.own : state.value?.scene)?.model ?? "";

function Cursors({ placed, size }: { placed: Placed; size: Size }): ComponentChildren {
  const here = others.value.filter((person) => modelOf(person) === info.value?.model);
  return here.map((person) => {
    const position = positionOf(person.cursor);
    const at = position && project(placed, position, size.w, size.h);
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
  });
}

const HINTS = {
  none: "",
  pin: "Click on the model where the pin goes. Esc stops.",
  draw: "Draw on the model. Esc stops.",
};

export function Pins() {
  const host = useRef<HTMLDivElement>(null);
  const size = useSignal<Size>({ w: 1, h: 1 });
  useHands(host, size);
  void info.value;
  void status.value.mode;
  const now = size.value;
  const placed = viewer?.framed ? viewer.placed(scene.value) : null;
  return (
    <div ref={host} class={`pins-over ${tool.value === "none" ? "" : "placing"}`}>
      {placed && <Strokes placed={placed} size={now} />}
      {placed && <Marks placed={placed} size={now} />}
      {placed && <Cursors placed={placed} size={now} />}
      {tool.value !== "none" && (
        <p class="placing-hint" role="status">
          {HINTS[tool.value]}
        </p>
      )}
    </div>
  );
}
