// SPDX-License-Identifier: MIT
// Two states of the scene at once: side by side, behind a wipe, or as a map of their difference.
// A is the scene that the panels change, B a state that was kept; both have A's camera.
import { effect, signal, useSignalEffect } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { MAP_MOST, difference, heat, type Difference } from "../scene/color-difference";
import { NO_STATUS, type Status } from "../scene/viewer";
import type { CompareMode, SceneState } from "../state/scene-state";
import { Choice, Icon, Section, Slider } from "./controls";
import { makeViewer } from "./make-viewer";
import { alsoViewer, change, commit, connection, scene, set, status, viewer } from "./store";
import type { Viewer } from "../scene/viewer";

const MODES: { value: CompareMode; label: string }[] = [
  { value: "side", label: "Side by side" },
  { value: "wipe", label: "Wipe" },
  { value: "difference", label: "ΔE map" },
];
const PIXELS = 200_000; // most that a map has
const REST_MS = 120; // a map waits for hands to rest

const otherStatus = signal<Status>(NO_STATUS);
export const measured = signal<Difference | null>(null);

function keep(): void {
  const { compare, ...now } = scene.value;
  set({
    compare: {
      mode: compare?.mode ?? "wipe",
      at: compare?.at ?? 0.5,
      other: { ...now, compare: null },
    },
  });
}
/** A becomes B, and B becomes A; the camera stays. */
export function swap(): void {
  const { compare, ...now } = scene.value;
  if (!compare) return;
  scene.value = {
    ...compare.other,
    orbit: now.orbit,
    compare: { ...compare, other: { ...now, compare: null } },
  };
  commit();
}
function setMode(mode: CompareMode): void {
  const { compare } = scene.value;
  if (compare) set({ compare: { ...compare, mode } });
}

function WipeSlider() {
  const { compare } = scene.value;
  if (!compare) return null;
  return (
    <Slider
      label="Wipe"
      unit="%"
      min={0}
      max={100}
      value={100 * compare.at}
      onInput={(x) => change({ compare: { ...compare, at: x / 100 } })}
      onDone={commit}
    />
  );
}

// The map is of pixels that are drawn here: the daemon draws a model without a bake.
const drawnByDaemon = () =>
  status.value.mode === "pictures" || otherStatus.value.mode === "pictures";

function Numbers() {
  const found = measured.value;
  if (drawnByDaemon())
    return <p class="hint">There is no map: the daemon draws one of the two models.</p>;
  if (!found) return <p class="hint">The map is computed when both pictures are there.</p>;
  return (
    <p class="hint" role="status">
      ΔE₀₀ of the model: mean {found.mean.toFixed(2)}, most {found.most.toFixed(1)};{" "}
      {(100 * found.seen).toFixed(0)} % of it differ visibly (above 2.3).
    </p>
  );
}

export function ComparePanel() {
  const { compare } = scene.value;
  if (!compare)
    return (
      <Section title="Compare">
        <div class="row">
          <button type="button" onClick={keep}>
            <Icon name="compare" /> Keep this as B
          </button>
        </div>
        <p class="hint">Then change light, medium or model, and see both.</p>
      </Section>
    );
  return (
    <Section title="Compare">
      <Choice label="Comparison" value={compare.mode} options={MODES} onChange={setMode} />
      {compare.mode === "wipe" && <WipeSlider />}
      {compare.mode === "difference" && <Numbers />}
      <div class="row">
        <button type="button" onClick={swap}>
          Swap A and B
        </button>
        <button type="button" onClick={keep}>
          Keep this as B
        </button>
        <button type="button" onClick={() => set({ compare: null })}>
          <Icon name="close" /> End
        </button>
      </div>
    </Section>
  );
}

// B as it is shown: with the camera of A.
function shownOther(): SceneState | null {
  const { compare, orbit } = scene.value;
  return compare ? { ...compare.other, orbit } : null;
}

function drawMap(canvas: HTMLCanvasElement, a: Viewer, b: Viewer): void {
  const { clientWidth, clientHeight } = canvas;
  const k = Math.min(1, Math.sqrt(PIXELS / Math.max(1, clientWidth * clientHeight)));
  const w = Math.max(1, Math.round(k * clientWidth));
  const h = Math.max(1, Math.round(k * clientHeight));
  const [one, two] = [a.stage?.readEncoded(w, h), b.stage?.readEncoded(w, h)];
  // Each has its own background.
  const [back, back2] = [a.stage?.readEncoded(w, h, false), b.stage?.readEncoded(w, h, false)];
  if (!one || !two || !back || !back2) return;
  const model = (i: number) =>
    [0, 1, 2].some(
      (c) => one[4 * i + c] !== back[4 * i + c] || two[4 * i + c] !== back2[4 * i + c],
    );
  const found = difference(one, two, model);
  measured.value = found;
  canvas.width = w;
  canvas.height = h;
  const context = canvas.getContext("2d");
  // Rows of WebGL begin at the bottom.
  for (let y = 0; y < h; y++)
    context?.putImageData(
      new ImageData(found.map.slice(4 * w * y, 4 * w * (y + 1)), w),
      0,
      h - 1 - y,
    );
}

function Map({ other }: { other: { current: Viewer | null } }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const timer = useRef<ReturnType<typeof setTimeout> | undefined>(undefined);
  const draw = () => {
    const [a, b] = [viewer, other.current];
    if (!canvas.current || !a || !b || drawnByDaemon()) return;
    if (!a.settled || !b.settled) later();
    else drawMap(canvas.current, a, b);
  };
  const later = () => {
    clearTimeout(timer.current);
    timer.current = setTimeout(draw, REST_MS);
  };
  useSignalEffect(() => {
    void [scene.value, status.value.frames, otherStatus.value.frames];
    later();
  });
  useEffect(
    () => () => {
      clearTimeout(timer.current);
      measured.value = null;
    },
    [],
  );
  const ramp = [0, 0.2, 0.4, 0.6, 0.8, 1].map((x) => `rgb(${heat(x).join(" ")})`).join(", ");
  return (
    <>
      <canvas ref={canvas} class="map" aria-hidden="true" hidden={drawnByDaemon()} />
      <div class="legend" aria-hidden="true">
        <span>ΔE₀₀ 0</span>
        <i style={{ background: `linear-gradient(90deg, ${ramp})` }} />
        <span>{MAP_MOST}</span>
      </div>
    </>
  );
}

// The line between A and B. A hand moves the one of a wipe.
function Divider() {
  const move = (event: PointerEvent) => {
    const line = event.currentTarget as HTMLElement;
    const box = line.parentElement?.getBoundingClientRect();
    const { compare } = scene.value;
    if (!compare || !box || !line.hasPointerCapture(event.pointerId)) return;
    const at = Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
    change({ compare: { ...compare, at } });
  };
  return (
    <i
      class="divider"
      onPointerDown={(event) => {
        event.stopPropagation(); // it turns no model
        event.currentTarget.setPointerCapture(event.pointerId);
      }}
      onPointerMove={move}
      onPointerUp={commit}
      onPointerCancel={commit}
    />
  );
}

/** The panes of B, over the pane of A. */
export function CompareStage() {
  const pane = useRef<HTMLDivElement>(null);
  const canvas = useRef<HTMLCanvasElement>(null);
  const picture = useRef<HTMLCanvasElement>(null);
  const made = useRef<Viewer | null>(null);
  useEffect(() => {
    const box = pane.current;
    if (!box || !canvas.current || !picture.current) return undefined;
    let live = true;
    let end: (() => void) | undefined;
    const nodes = { canvas: canvas.current, pictureCanvas: picture.current };
    const events = {
      status: (value: Status) => (otherStatus.value = value),
      info: () => undefined,
    };
    void makeViewer(nodes, events).then((one) => {
      if (!live) {
        one.end();
        return;
      }
      made.current = one;
      Object.assign(globalThis, { relightOther: one }); // for tests and for the console
      const observer = new ResizeObserver(() => one.resized());
      observer.observe(box);
      one.resized();
      const forget = alsoViewer(one);
      const stop = effect(() => {
        const state = shownOther();
        if (state && connection.value.is === "ready") one.show(state);
      });
      end = () => {
        stop();
        forget();
        observer.disconnect();
        one.end();
      };
    });
    return () => {
      live = false;
      made.current = null;
      otherStatus.value = NO_STATUS;
      end?.();
    };
  }, []);
  const { compare } = scene.value;
  return (
    <>
      <div ref={pane} class="pane b">
        <canvas ref={canvas} class="gl" aria-hidden="true" />
        <canvas ref={picture} class="picture" aria-hidden="true" hidden />
      </div>
      {compare?.mode === "difference" ? (
        <Map other={made} />
      ) : (
        <>
          <span class="name-a">A</span>
          <span class="name-b">B</span>
          <Divider />
        </>
      )}
    </>
  );
}
