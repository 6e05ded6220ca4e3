// SPDX-License-Identifier: MIT
// The page's one store: the connection, the scene with its history, what the daemon has, and
// what is said to the person.
import { computed, effect, signal } from "@preact/signals";
import {
  EventKind,
  EventSchema,
  ImageFormat,
  ListAnswerSchema,
  ListRequestSchema,
  LoadAnswerSchema,
  LoadRequestSchema,
  SubscribeRequestSchema,
  Engine,
  type EnvironmentEntry,
  type ModelInfo,
} from "../gen/relight_pb";
import { busyMs, whenFree } from "../protocol/busy";
import { Client, type ConnectionState } from "../protocol/client";
import { DisconnectedError, explain, PageError, type Notice } from "../protocol/errors";
import { Type } from "../protocol/frame";
import { upload } from "../protocol/upload";
import { roomId } from "../room/here";
import { clampOrbit, START, type Orbit } from "../scene/camera";
import { NO_STATUS, type Status, type Viewer } from "../scene/viewer";
import { keep, kept } from "../state/kept";
import { holdsAnyEta, mediaObjects, parseMedium } from "../state/material";
import { FIRST_LAMP, type LampState, type SceneState } from "../state/scene-state";
import { fromFragment, toFragment } from "../state/url";

const TOKEN_KEY = "relight-token";

// ---- the token: from the fragment or a prompt, kept for the tab, for longer only when asked

/** The token of a link, which goes out of the address; null: it has none. */
function tokenOfLink(): string | null {
  const words = new URLSearchParams(location.hash.slice(1));
  const given = words.get("token");
  if (given === null) return null;
  words.delete("token");
  history.replaceState(history.state, "", `#${words.toString()}`);
  keep("sessionStorage", TOKEN_KEY, given);
  return given;
}
const firstToken = () =>
  tokenOfLink() ?? kept("sessionStorage", TOKEN_KEY) ?? kept("localStorage", TOKEN_KEY) ?? "";

export function useToken(token: string, remember: boolean): void {
  keep("sessionStorage", TOKEN_KEY, token);
  keep("localStorage", TOKEN_KEY, remember ? token : null);
  client.useToken(token);
}

// ---- signals

const token = firstToken();
export const connection = signal<ConnectionState>({ is: "connecting" });
export const scene = signal<SceneState>(fromFragment(location.hash));
export const status = signal<Status>(NO_STATUS);
export const info = signal<ModelInfo | null>(null);
export const models = signal<ModelInfo[] | null>(null);
export const environments = signal<EnvironmentEntry[]>([]);
export const notice = signal<Notice | null>(null);
export const bytesPerSecond = signal(0);
export const busy = signal("");
export interface UploadState {
  name: string;
  share: number;
  cancelled: boolean;
}
export const uploading = signal<UploadState | null>(null);
/** What a dropped model is taken for. */
export const uploadSizeMm = signal(50);
export const uploadMaterial = signal("marble");
export const uploadUpZ = signal(false);
export const uploadFlipV = signal(false);
/** What was baked last by this page, so that its size or medium can be chosen anew. */
export const lastUpload = signal<{ model: string; name: string; hash: string } | null>(null);

const hasScope = (scope: string) =>
  connection.value.is === "ready" && connection.value.hello.scopes.includes(scope);
export const mayUpload = computed(() => hasScope("upload"));
/** Whether this token may stop bakes and make rooms. */
export const mayEdit = computed(() => hasScope("edit"));
/** Whether the medium of the shown model can be changed. */
export const materialIsOpen = computed(() => {
  const shown = info.value;
  if (!shown) return false;
  return (
    shown.engine === Engine.JOINT ||
    shown.engine === Engine.POLYNOMIAL ||
    status.value.mode === "pictures"
  );
});
/** Whether media of another refractive index can be chosen. */
export const etaIsOpen = computed(
  () => status.value.mode === "pictures" || holdsAnyEta(info.value?.settings ?? ""),
);
/** The objects whose media can be chosen apart, by the names that the daemon takes; none of a model
 * with one. */
export const objects = computed(() => mediaObjects(info.value));
const chosenObject = signal("");
/** The object whose medium is edited; empty: all that have none of their own. */
export const editedObject = computed(() =>
  objects.value.some(({ name }) => name === chosenObject.value) ? chosenObject.value : "",
);
export const editObject = (name: string) => (chosenObject.value = name);
/** Text of the medium that is edited. */
export const mediumTextShown = computed(() => {
  const { material, materials } = scene.value;
  const object = objects.value.find(({ name }) => name === editedObject.value);
  const own = object ? info.value?.media[object.medium] : info.value?.material;
  return (object && materials[object.name]) || material || own || "";
});
/** The part of the scene that gives the edited object another medium; empty: the model's own. */
export function withMedium(text: string): Pick<SceneState, "material" | "materials"> {
  const { material, materials } = scene.value;
  const object = editedObject.value;
  if (!object) return { material: text, materials };
  const others = Object.entries(materials).filter(([name]) => name !== object);
  return {
    material,
    materials: Object.fromEntries(text ? [...others, [object, text]] : others),
  };
}
export const medium = computed(() => parseMedium(mediumTextShown.value));

export const client = new Client(
  `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`,
  { token, name: "relight-page 0.1.0", changed: connectionChanged },
);
export let viewer: Viewer | null = null;

const others = new Set<Viewer>();
/** Another viewer of this connection; returns what forgets it. */
export function alsoViewer(made: Viewer): () => void {
  others.add(made);
  return () => others.delete(made);
}

export function useViewer(made: Viewer): void {
  viewer = made;
  if (connection.value.is === "ready") viewer.show(scene.value);
}

// ---- the scene and its history

const undone = signal<SceneState[]>([]);
const done = signal<SceneState[]>([]);
/** In a room undo and redo are the room's; open: this person may change it. */
export const roomHistory = signal<{
  undo: () => void;
  redo: () => void;
  open: boolean;
} | null>(null);
export const canUndo = computed(() => roomHistory.value?.open ?? done.value.length > 0);
export const canRedo = computed(() => roomHistory.value?.open ?? undone.value.length > 0);
let committed = scene.value;
/** Of the entries of the browser's history that the page made. Another one is a link that a person
 * opened. */
export const MADE = { made: "page" };

/** Changes the scene; commit() makes a step of it. */
export function change(part: Partial<SceneState>): void {
  scene.value = { ...scene.value, ...part };
}
/** A finished change: a step of undo, and an entry of the browser's history. A room has one entry:
 * Back leaves it. */
export function commit(): void {
  const now = scene.value;
  if (toFragment(now) === toFragment(committed)) return;
  done.value = [...done.value, committed].slice(-100);
  undone.value = [];
  committed = now;
  if (roomId.value) keepAddress();
  else history.pushState(MADE, "", `#${toFragment(now)}`);
}
/** The address of the current scene. Writes it first: while the turntable turns it is out of date. */
export function linkNow(): string {
  commit();
  return location.href;
}
/** The address holds the scene; no entry is added. */
export function keepAddress(): void {
  history.replaceState(MADE, "", `#${toFragment(committed)}`);
}
export function showAddress(): void {
  scene.value = committed = fromFragment(location.hash);
}
/** The scene as it is now is the first that undo goes back to. */
export function beginHistory(): void {
  done.value = undone.value = [];
  committed = scene.value;
  keepAddress();
}
export function set(part: Partial<SceneState>): void {
  change(part);
  commit();
}
function step(from: typeof done, to: typeof done): void {
  const next = from.value.at(-1);
  if (!next) return;
  from.value = from.value.slice(0, -1);
  to.value = [...to.value, committed];
  committed = next;
  scene.value = next;
  keepAddress();
}
export const undo = () => (roomHistory.value ? roomHistory.value.undo() : step(done, undone));
export const redo = () => (roomHistory.value ? roomHistory.value.redo() : step(undone, done));

// In a room all share the scene: room/session.ts handles Back there. A person may open another link in
// this tab: a new invitation, in place of one that has expired.
addEventListener("popstate", () => {
  const given = tokenOfLink();
  if (given !== null) client.useToken(given);
  if (!roomId.value) showAddress();
});

export function setOrbit(orbit: Orbit): void {
  change({ orbit: clampOrbit(orbit) });
}
export function resetOrbit(): void {
  set({ orbit: START });
}
export function setLamp(index: number, part: Partial<LampState>): void {
  change({
    lamps: scene.value.lamps.map((lamp, i) => (i === index ? { ...lamp, ...part } : lamp)),
  });
}
const turned = (deg: number) => ((deg % 360) + 360) % 360;
/** Turns all lamps, as a hand on the stage does. Lights of a room are turned, but not raised. */
export function turnLight(rotate: number, tilt: number): void {
  const raised = roomId.value ? 0 : tilt;
  change({
    lamps: scene.value.lamps.map((lamp) => ({
      ...lamp,
      rotate: turned(lamp.rotate + rotate),
      tilt: Math.min(90, Math.max(-90, lamp.tilt + raised)),
    })),
  });
}
export function addLamp(): void {
  set({ lamps: [...scene.value.lamps, { ...FIRST_LAMP, env: "page:rim" }] });
}
export function removeLamp(index: number): void {
  if (scene.value.lamps.length > 1)
    set({ lamps: scene.value.lamps.filter((_, i) => i !== index) });
}

effect(() => client.lookAt(scene.value.model));
effect(() => {
  const now = scene.value; // read even before there is a viewer: the effect follows it
  viewer?.show(now);
});

// ---- the daemon

let saidBy: symbol | null = null; // the source of the notice
const CONNECTION = Symbol("connection");
const LISTS = Symbol("lists");

/** Says a fault. Of a source that goes on by itself, so that its end clears the notice; null: of
 * what a person did once. again: the request is repeated by itself. */
export function fault(error: unknown, source: symbol | null = null, again = false): void {
  saidBy = source;
  notice.value = explain(error, again);
}
/** An earlier fault of this source has ended. */
export function fine(source: symbol): void {
  if (saidBy === source && notice.value?.kind !== "forbidden") notice.value = null;
}

function connectionChanged(state: ConnectionState): void {
  // An attempt may wait for minutes: until it ends the page is offline as before.
  if (state.is === "connecting" && connection.value.is === "offline") return;
  connection.value = state;
  if (state.is === "ready") {
    if (saidBy === CONNECTION || notice.value?.kind === "offline") notice.value = null;
    void refresh();
    subscribe();
    viewer?.show(scene.value);
    void viewer?.open();
    for (const one of others) void one.open();
  } else if (state.is === "refused") fault(state.error, CONNECTION);
}

const listAfter = (after: bigint) =>
  client.request(
    Type.List,
    ListRequestSchema,
    { environments: !after, files: !after, after },
    ListAnswerSchema,
  );
// An answer has 256 models at most.
async function list() {
  const { message } = await listAfter(0n);
  const all = [...message.models];
  for (let { next } = message; next; ) {
    const { message: more } = await listAfter(next);
    all.push(...more.models);
    ({ next } = more);
  }
  return { ...message, models: all };
}
let reading = 0; // grows with every reading of the lists: the newest waits for a busy daemon
/** Reads the lists of models and environments anew. */
export async function refresh(): Promise<void> {
  if (client.hello?.principal.startsWith("guest:")) return; // a room alone
  const mine = ++reading;
  try {
    const message = await whenFree(list, (error) => {
      if (mine === reading) fault(error, LISTS, true);
      return mine === reading;
    });
    if (mine !== reading) return; // a newer one was asked for meanwhile
    models.value = message.models;
    environments.value = message.environments;
    files.value = message.files.map((file) => file.path);
    fine(LISTS);
    if (!scene.value.model) chooseFirst();
    for (const one of [viewer, ...others]) void one?.listed(message.models);
  } catch (error) {
    if (client.hello && mine === reading) fault(error, LISTS);
  }
}
/** Files of the daemon's models folder. */
export const files = signal<string[]>([]);

const baseOf = (path: string) => path.slice(path.lastIndexOf("/") + 1);
/** Those that no model is of. A model is called by its file's name without folders. */
export const unloadedFiles = computed(() => {
  const names = new Set((models.value ?? []).map(({ name }) => name));
  const isLoaded = (path: string) =>
    names.has(path) || (names.has(baseOf(path)) && !files.value.includes(baseOf(path)));
  return files.value.filter((path) => path.endsWith(".prt") && !isLoaded(path));
});
/** The word by which a scene names a model: a name that another one has too, or two files, is none. */
export function wordOf({ name, model }: ModelInfo): string {
  const isShared =
    (models.value ?? []).some((one) => one.name === name && one.model !== model) ||
    files.value.filter((path) => baseOf(path) === name).length > 1;
  return isShared ? model : name || model;
}

function chooseFirst(): void {
  const first = models.value?.[0];
  if (first) {
    change({ model: wordOf(first) });
    committed = scene.value;
    keepAddress(); // a copy of it shows the same model
    return;
  }
  const file = files.value.find((path) => path.endsWith(".prt"));
  if (file) void openFile(file);
}

/** Loads a file of the models folder and shows it. */
export async function openFile(path: string): Promise<void> {
  busy.value = `Loading ${path}`;
  try {
    const { message } = await client.request(
      Type.Load,
      LoadRequestSchema,
      { path },
      LoadAnswerSchema,
    );
    const isFirst = !scene.value.model;
    change({ model: message.model, material: "", materials: {}, variant: "" });
    if (isFirst) beginHistory();
    else commit();
    await refresh();
  } catch (error) {
    fault(error);
  } finally {
    busy.value = "";
  }
}

let refreshTimer: ReturnType<typeof setTimeout> | undefined;
let subscription = 0n;
function subscribe(): void {
  const mine = (subscription = client.stream(
    Type.Subscribe,
    SubscribeRequestSchema,
    {
      kinds: [
        EventKind.EVENT_MODEL_ADDED,
        EventKind.EVENT_MODEL_CHANGED,
        EventKind.EVENT_MODEL_REPLACED,
        EventKind.EVENT_MODEL_REMOVED,
        EventKind.EVENT_ENVIRONMENT_ADDED,
      ],
    },
    EventSchema,
    ({ message }) => {
      if (message.kind === EventKind.EVENT_NONE && !message.lost) return;
      clearTimeout(refreshTimer);
      refreshTimer = setTimeout(() => void refresh(), 250);
    },
    (error) => {
      const wait = busyMs(error);
      if (wait !== null) setTimeout(() => subscription === mine && subscribe(), wait);
    },
  ));
}

// ---- uploads

/** Index of the lamp that a chosen or uploaded environment is for; the last one where there are fewer. */
export const chosenLamp = signal(0);
export const chosenIndex = () => Math.min(chosenLamp.value, scene.value.lamps.length - 1);

const MODEL_FILE = /\.(glb|gltf|obj|ply|stl|prt)$/i;
const LIGHT_FILE = /\.(hdr|exr|png|jpe?g)$/i;

/** A dropped or chosen file: a model is shown at once and baked, an image becomes the light. */
export function takeFiles(list: Iterable<File>): Promise<void> {
  const files = [...list]; // a browser may empty its list
  return (taking = taking.then(() => takeAll(files)));
}
let taking = Promise.resolve(); // one file after the other, also of a later drop
async function takeAll(files: readonly File[]): Promise<void> {
  for (const file of files) {
    if (!MODEL_FILE.test(file.name) && !LIGHT_FILE.test(file.name)) {
      fault(
        new PageError(
          `${file.name} is no model (.glb .gltf .obj .ply .stl) and no light (.hdr .exr .png .jpg)`,
        ),
      );
      continue;
    }
    try {
      await takeFile(file);
    } catch (error) {
      if (!uploading.value?.cancelled) fault(error);
    } finally {
      uploading.value = null;
    }
  }
}
// After a lost connection the upload resumes: the daemon keeps the bytes that it received.
async function takeFile(file: File): Promise<void> {
  uploading.value = { name: file.name, share: 0, cancelled: false };
  const bytes = new Uint8Array(await file.arrayBuffer());
  for (;;)
    try {
      await sendFile(file, bytes);
      return;
    } catch (error) {
      if (!(error instanceof DisconnectedError) || !(await untilBack())) throw error;
    }
}
// Until the connection is back; false: it does not come, or the person waits for it no longer.
function untilBack(): Promise<boolean> {
  return new Promise((done) => {
    const stop = effect(() => {
      const { is } = connection.value;
      const over = is === "refused" || (uploading.value?.cancelled ?? true);
      if (!over && is !== "ready") return;
      done(!over);
      queueMicrotask(() => stop());
    });
  });
}
async function sendFile(file: File, bytes: Uint8Array): Promise<void> {
  const hash = await upload(
    client,
    file.name,
    bytes,
    (share) => {
      if (uploading.value) uploading.value = { ...uploading.value, share };
    },
    () => uploading.value?.cancelled ?? false,
  );
  if (uploading.value?.cancelled) return;
  if (LIGHT_FILE.test(file.name)) {
    const index = chosenIndex();
    const lamp = { ...FIRST_LAMP, env: `env:${hash}` };
    set({
      lamps: scene.value.lamps.map((one, i) => (i === index ? lamp : one)),
      background: "environment",
    });
    await refresh();
  } else await loadUpload(file.name, hash);
}
/** Loads an uploaded model in the size, axes and medium that are chosen; the daemon begins its bake. */
export async function loadUpload(name: string, hash: string): Promise<void> {
  const { message } = await client.request(
    Type.Load,
    LoadRequestSchema,
    {
      files: [{ name, blob: hash }],
      name,
      sizeMm: uploadSizeMm.value,
      material: uploadMaterial.value,
      upZ: uploadUpZ.value,
      flipV: uploadFlipV.value,
      // a medium that is edited later may be of any index
      ...(uploadMaterial.value ? {} : { bake: { anyEta: true } }),
    },
    LoadAnswerSchema,
  );
  lastUpload.value = { model: message.model, name, hash };
  set({ model: message.model, material: "", materials: {}, variant: "", orbit: START });
  await refresh();
}

// ---- pictures to keep

export function save(bytes: Uint8Array, name: string, type: string): void {
  const url = URL.createObjectURL(new Blob([bytes.slice()], { type }));
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
}
export async function screenshot(kind: "png" | "exr"): Promise<void> {
  busy.value = "The daemon draws the picture";
  try {
    const format = kind === "png" ? ImageFormat.IMAGE_PNG : ImageFormat.IMAGE_EXR;
    const picture = await viewer?.still(format);
    const name = (info.value?.name || "relight").replace(/\.[a-z0-9]+$/i, "");
    if (picture)
      save(picture.bytes, `${name}.${kind}`, kind === "png" ? "image/png" : "image/x-exr");
  } catch (error) {
    fault(error);
  } finally {
    busy.value = "";
  }
}

let receivedBefore = 0;
setInterval(() => {
  bytesPerSecond.value = client.received - receivedBefore;
  receivedBefore = client.received;
}, 1000);
