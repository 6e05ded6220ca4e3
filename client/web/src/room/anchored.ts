// SPDX-License-Identifier: MIT
// The pins and strokes of the room on the mesh that is shown.
import { computed, effect } from "@preact/signals";
import type { Pin, Stroke, SurfacePoint } from "../gen/relight_pb";
import type { Mesh } from "../scene/geometry";
import { info, status, viewer } from "../ui/store";
import { anchorOf, fitsMesh, sameMesh, type Anchor } from "./anchor";
import { state } from "./here";

// By room, number of the pin or stroke, and whether the mesh is its own.
const known = new WeakMap<Mesh, Map<string, Anchor[]>>();
const LEAST = 4000; // points of a stroke that are sought on another mesh, of all strokes

function remembered(mesh: Mesh, key: string, make: () => Anchor[]): Anchor[] {
  let all = known.get(mesh);
  if (!all) known.set(mesh, (all = new Map<string, Anchor[]>()));
  const own = `${state.value?.room ?? ""} ${key}`;
  let found = all.get(own);
  if (!found) all.set(own, (found = make()));
  return found;
}

function pinAnchor(mesh: Mesh | null, model: string, pin: Pin): Anchor | null {
  const number = String(pin.stamp?.sequence);
  if (mesh) {
    const same = sameMesh(mesh, model, pin.seen);
    const make = () => [anchorOf(mesh, same, pin.at)];
    return remembered(mesh, `pin ${number} ${same}`, make)[0] ?? null;
  }
  // The daemon draws: the page has no surface. On the pin's own model it is where it was.
  const p = pin.at?.position;
  if (!p || pin.seen?.model !== model) return null;
  return { state: "same", distance: 0, position: [p.x, p.y, p.z], normal: [0, 0, 0] };
}

// The daemon may draw the model; pins and cursors need its surface all the same.
effect(() => {
  if (state.value && status.value.mode === "pictures") void viewer?.bringShape();
});
const shownMesh = computed(() => {
  void status.value; // the mesh comes with it
  return viewer?.shape ?? null;
});
const shownModel = computed(() => info.value?.model ?? "");

/** By the pin's number. Missing: the page cannot say where it lies. */
export const anchors = computed<ReadonlyMap<bigint, Anchor>>(() => {
  const [mesh, model] = [shownMesh.value, shownModel.value];
  const out = new Map<bigint, Anchor>();
  for (const pin of state.value?.pins ?? []) {
    const anchor = pinAnchor(mesh, model, pin);
    if (anchor) out.set(pin.stamp?.sequence ?? 0n, anchor);
  }
  return out;
});

export interface Line {
  stroke: Stroke;
  points: Anchor[];
}
function lineOf(mesh: Mesh, model: string, stroke: Stroke, most: number): Line {
  const all = stroke.line?.points ?? [];
  const pin = state.value?.pins.find((one) => one.stamp?.sequence === stroke.line?.pin);
  const same = pin ? sameMesh(mesh, model, pin.seen) : fitsMesh(mesh, all);
  const key = `stroke ${String(stroke.stamp?.sequence)} ${same}`;
  const step = same ? 1 : Math.max(1, Math.ceil(all.length / most));
  const make = () =>
    all
      .filter((_: SurfacePoint, i) => i % step === 0 || i === all.length - 1)
      .map((point) => anchorOf(mesh, same, point));
  return { stroke, points: remembered(mesh, key, make) };
}
export const lines = computed<Line[]>(() => {
  const [mesh, model] = [shownMesh.value, shownModel.value];
  const strokes = state.value?.strokes ?? [];
  const most = Math.max(8, Math.floor(LEAST / Math.max(1, strokes.length)));
  return mesh ? strokes.map((stroke) => lineOf(mesh, model, stroke, most)) : [];
});
