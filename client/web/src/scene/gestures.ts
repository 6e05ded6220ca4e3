// SPDX-License-Identifier: MIT
// Hands on the stage. One pointer orbits; with Shift, or two fingers that move together, the light
// turns; the right or middle button pans; wheel and pinch magnify. The same by keys.
import type { Orbit } from "./camera";

export interface GestureTarget {
  orbit: () => Orbit;
  setOrbit: (orbit: Orbit) => void;
  /** Degrees by which the light turns and tilts. */
  turnLight: (rotate: number, tilt: number) => void;
  reset: () => void;
  /** The end of a movement: a step of undo. */
  commit: () => void;
  /** Whether the last movement waits to be drawn: those that follow are added up. */
  busy?: () => boolean;
}

const ORBIT_DEG = 0.35; // a pixel
const LIGHT_DEG = 0.45;
const KEY_DEG = 6;

export function attachGestures(element: HTMLElement, to: GestureTarget): () => void {
  const pointers = new Map<number, { x: number; y: number }>();
  let wheelTimer: ReturnType<typeof setTimeout> | undefined;
  const stop = new AbortController();
  const { signal } = stop;

  const orbitBy = (dx: number, dy: number) => {
    const orbit = to.orbit();
    to.setOrbit({
      ...orbit,
      azimuth: orbit.azimuth - dx * ORBIT_DEG,
      elevation: orbit.elevation + dy * ORBIT_DEG,
    });
  };
  const panBy = (dx: number, dy: number) => {
    const orbit = to.orbit();
    const k = 2.2 / (element.clientHeight * orbit.zoom);
    to.setOrbit({ ...orbit, panX: orbit.panX - dx * k, panY: orbit.panY + dy * k });
  };
  const zoomBy = (factor: number) => {
    const orbit = to.orbit();
    to.setOrbit({ ...orbit, zoom: orbit.zoom * factor });
  };

  // Movements are added up until the one before is being drawn, and the display's next frame.
  let waiting: { act: (dx: number, dy: number) => void; dx: number; dy: number } | null = null;
  let frame = 0;
  const flush = () => {
    const last = waiting;
    waiting = null;
    last?.act(last.dx, last.dy);
  };
  const step = () => {
    frame = waiting && to.busy?.() ? requestAnimationFrame(step) : 0;
    if (!frame) flush();
  };
  const move = (act: (dx: number, dy: number) => void, dx: number, dy: number) => {
    if (waiting && waiting.act !== act) flush();
    waiting = { act, dx: (waiting?.dx ?? 0) + dx, dy: (waiting?.dy ?? 0) + dy };
    frame ||= requestAnimationFrame(step);
  };
  const commit = () => {
    flush();
    to.commit();
  };
  const lightBy = (dx: number, dy: number) => to.turnLight(dx * LIGHT_DEG, dy * LIGHT_DEG);

  element.addEventListener(
    "pointerdown",
    (event) => {
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      element.setPointerCapture(event.pointerId);
      element.focus({ preventScroll: true });
    },
    { signal },
  );
  const moved = (event: PointerEvent) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const dx = event.clientX - before.x;
    const dy = event.clientY - before.y;
    const [other] = [...pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (other) {
      const distance = (x: number, y: number) => Math.hypot(x - other.x, y - other.y);
      zoomBy(
        distance(event.clientX, event.clientY) / Math.max(1, distance(before.x, before.y)),
      );
      move(lightBy, dx / 2, dy / 2);
    } else if (event.shiftKey) move(lightBy, dx, dy);
    else if (event.buttons & 6 || event.ctrlKey) move(panBy, dx, dy);
    else move(orbitBy, dx, dy);
  };
  element.addEventListener("pointermove", moved, { signal });
  const ended = (event: PointerEvent) => {
    if (pointers.delete(event.pointerId) && !pointers.size) commit();
  };
  element.addEventListener("pointerup", ended, { signal });
  element.addEventListener("pointercancel", ended, { signal });
  element.addEventListener("contextmenu", (event) => event.preventDefault(), { signal });
  element.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      if (event.shiftKey) to.turnLight((event.deltaX || event.deltaY) * 0.1, 0);
      else zoomBy(Math.exp(-event.deltaY * (event.ctrlKey ? 0.01 : 0.0015)));
      clearTimeout(wheelTimer);
      wheelTimer = setTimeout(() => to.commit(), 300);
    },
    { signal, passive: false },
  );
  element.addEventListener("dblclick", () => to.reset(), { signal });

  const arrows: Record<string, [number, number]> = {
    ArrowLeft: [-1, 0],
    ArrowRight: [1, 0],
    ArrowUp: [0, -1],
    ArrowDown: [0, 1],
  };
  element.addEventListener(
    "keydown",
    (event) => {
      const arrow = arrows[event.key];
      if (event.ctrlKey || event.metaKey) return;
      if (arrow && event.shiftKey) to.turnLight(arrow[0] * KEY_DEG, arrow[1] * KEY_DEG);
      else if (arrow && event.altKey) panBy(-arrow[0] * 20, -arrow[1] * 20);
      else if (arrow)
        orbitBy((-arrow[0] * KEY_DEG) / ORBIT_DEG, (-arrow[1] * KEY_DEG) / ORBIT_DEG);
      else if (event.key === "+" || event.key === "=") zoomBy(1.15);
      else if (event.key === "-") zoomBy(1 / 1.15);
      else if (event.key === "0" || event.key === "Home") to.reset();
      else return;
      event.preventDefault();
      to.commit();
    },
    { signal },
  );
  return () => {
    cancelAnimationFrame(frame);
    stop.abort();
  };
}
