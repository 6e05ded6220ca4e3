// SPDX-License-Identifier: MIT
import { expect, test, vi } from "vitest";
import { create, type MessageInitShape } from "@bufbuild/protobuf";
import {
  ColorFormat,
  ErrorCode,
  FactorsAnswerSchema,
  GeometryAnswerSchema,
  ImageFormat,
  JobState,
  ModelInfoSchema,
  ModelState,
  ProgressSchema,
  Term,
  ViewFrameSchema,
  type ViewFrame,
} from "../src/gen/relight_pb";
import { DisconnectedError, RelightError } from "../src/protocol/errors";
import { Type } from "../src/protocol/frame";
import type { Client } from "../src/protocol/client";
import type { Stage } from "../src/scene/stage";
import { Viewer, type Status } from "../src/scene/viewer";
import { FIRST, FIRST_LAMP } from "../src/state/scene-state";

type Ended = (error: Error | null) => void;
type Answered = (answer: { message: unknown }) => void;
type Framed = (frame: { message: ViewFrame; payload: Uint8Array }) => void;
const SLOW = { timeout: 60_000 }; // a busy machine
const busy = (retryAfterMs: number) =>
  new RelightError({ code: ErrorCode.ERROR_BUSY, text: "busy", hint: "", retryAfterMs });

interface ViewChange {
  fields: string[];
  lights?: { env?: unknown }[];
  picture?: { width: number; height: number; camera: { eye: { x: number } } };
}

const fakeCanvas = (clientWidth = 64, clientHeight = 64) =>
  Object.assign(new EventTarget(), { clientWidth, clientHeight }) as HTMLCanvasElement;

// A viewer of a daemon whose models all bake; what it watches and cancels.
function rig(
  refusals: RelightError[] = [],
  state = ModelState.MODEL_BAKING,
  stage: Stage | null = null,
) {
  const faults: { text: string; again: boolean }[] = [];
  const views: ((error: Error) => void)[] = [];
  const opened: ViewChange[] = [];
  const stills: string[] = []; // models
  const framed: Framed[] = []; // of the views
  const watched: string[] = [];
  const watches: { answered: Answered; ended: Ended }[] = [];
  const cancelled: bigint[] = [];
  const changes: ViewChange[] = [];
  const refused: RelightError[] = []; // answers to the changes that follow
  let id = 0n;
  const request = (type: Type, init: { model: string; state: ViewChange }) => {
    if (type === Type.ViewSet) changes.push(init.state);
    if (type === Type.Image) stills.push(init.model);
    const error = type === Type.Info ? refusals.shift() : undefined;
    const no = type === Type.ViewSet ? refused.shift() : error;
    if (no) return Promise.reject(no);
    const message =
      type === Type.Info ? create(ModelInfoSchema, { model: init.model, state }) : {};
    const answer = { message, payload: new Uint8Array(0) };
    if (type !== Type.Info) return Promise.resolve(answer);
    return new Promise((done) => setTimeout(() => done(answer), 1));
  };
  const client = {
    hello: {} as object | null,
    has: () => false,
    can: () => true,
    notify: () => undefined,
    cancel: (one: bigint) => cancelled.push(one),
    request: (type: Type, _: unknown, init: { model: string; state: ViewChange }) =>
      request(type, init),
    stream: (
      type: Type,
      _: unknown,
      init: { job: string; state: ViewChange },
      __: unknown,
      answered: Answered,
      ended: Ended,
    ) => {
      if (type === Type.Watch) {
        watched.push(init.job);
        watches.push({ answered, ended });
      }
      if (type === Type.ViewOpen) {
        opened.push(init.state);
        views.push(ended);
        framed.push(answered);
      }
      return ++id;
    },
  };
  const canvas = fakeCanvas(64, 48);
  const drawn: unknown[] = [];
  const said: Status[] = [];
  const pictureCanvas = {
    clientWidth: 0,
    clientHeight: 0,
    hidden: true,
    getContext: () => ({ drawImage: (one: { of: string }) => drawn.push(one.of) }),
  } as unknown as HTMLCanvasElement;
  const viewer = new Viewer(client as unknown as Client, { canvas, pictureCanvas }, stage, {
    status: (status) => said.push(status),
    info: () => undefined,
    fault: (error, again = false) => {
      if (!(error instanceof RelightError)) throw error;
      faults.push({ text: error.message, again });
    },
    fine: () => undefined,
  });
  const scene = (model: string) => ({
    ...FIRST,
    model,
    lamps: [{ ...FIRST_LAMP, env: "constant" }],
  });
  const show = async (model: string) => {
    viewer.show(scene(model));
    await new Promise((done) => setTimeout(done, 10));
  };
  const pictures = { stills, pictureCanvas, drawn, framed, opened };
  const rest = { ...pictures, client, said, watches, changes, refused };
  return { viewer, show, scene, watched, cancelled, faults, views, ...rest };
}

test("the bake of the model that is shown now is followed", async () => {
  const { show, watched, viewer } = rig();
  await show("a");
  await show("b");
  viewer.close();
  expect(watched).toEqual(["a", "b"]);
});

test("a bake that cannot be followed is tried again after a pause, its end at once", async () => {
  const { show, watched, watches, viewer } = rig();
  const wait = (ms: number) => new Promise((done) => setTimeout(done, ms));
  await show("a");
  watches[0]?.ended(busy(300));
  await wait(100);
  expect(watched.length).toBe(1);
  await wait(300);
  expect(watched.length).toBe(2);
  watches[1]?.answered({ message: create(ProgressSchema, { state: JobState.JOB_NONE }) });
  watches[1]?.ended(null);
  await wait(100);
  expect(watched.length).toBe(2);
  await wait(1000);
  expect(watched.length).toBe(3);
  watches[2]?.answered({ message: create(ProgressSchema, { state: JobState.JOB_DONE }) });
  watches[2]?.ended(null);
  await wait(100);
  expect(watched.length).toBe(4);
  watches[3]?.ended(busy(300));
  viewer.close();
  await wait(400);
  expect(watched.length).toBe(4);
});

test("a bake that may have ended while the connection was lost is not shown", async () => {
  const { show, client, watches, said, viewer } = rig();
  await show("a");
  const running = create(ProgressSchema, { state: JobState.JOB_RUNNING, fraction: 0.5 });
  watches[0]?.answered({ message: running });
  expect(said.at(-1)?.progress?.fraction).toBe(0.5);
  client.hello = null;
  watches[0]?.ended(new DisconnectedError());
  expect(said.at(-1)?.progress).toBeNull();
  viewer.close();
});

test("a bake that somebody else begins is followed, and opened where it was missed", async () => {
  const { show, watched, views, viewer } = rig([], ModelState.MODEL_PREVIEW);
  const listed = (model: string, state: ModelState) =>
    viewer.listed([create(ModelInfoSchema, { model, state })]);
  await show("a");
  await listed("b", ModelState.MODEL_BAKING);
  await listed("a", ModelState.MODEL_PREVIEW);
  expect([watched, views.length]).toEqual([[], 1]);
  await listed("a", ModelState.MODEL_BAKING);
  expect(watched).toEqual(["a"]);
  await listed("a", ModelState.MODEL_READY);
  await vi.waitFor(() => expect(views.length).toBe(2), SLOW);
  viewer.close();
});

test("a closed viewer follows no bake", async () => {
  const { show, cancelled, viewer } = rig();
  await show("a");
  viewer.close();
  expect(cancelled.length).toBe(1);
});

test("a model that a busy daemon refused is opened again when it said", async () => {
  const { show, faults, watched, viewer } = rig([busy(300)]);
  await show("a");
  expect(faults).toEqual([{ text: "busy", again: true }]);
  expect(watched).toEqual([]);
  await new Promise((done) => setTimeout(done, 400));
  expect(watched).toEqual(["a"]);
  viewer.close();
});

test("a view that a busy daemon ended is opened again, unless it was closed", async () => {
  const { show, views, viewer } = rig();
  await show("a");
  views[0]?.(busy(300));
  await new Promise((done) => setTimeout(done, 400));
  expect(views.length).toBe(2);
  views[1]?.(busy(300));
  viewer.close();
  await new Promise((done) => setTimeout(done, 400));
  expect(views.length).toBe(2);
});

test("light that a lost GPU had is asked for again, unless the viewer was closed", async () => {
  const { show, viewer, changes } = rig();
  await show("a");
  viewer.canvas.dispatchEvent(new Event("webglcontextrestored"));
  await vi.waitFor(() => expect(changes.length).toBe(1), { timeout: 10_000 });
  viewer.close();
  viewer.canvas.dispatchEvent(new Event("webglcontextrestored"));
  await new Promise((done) => setTimeout(done, 10));
  expect(changes.length).toBe(1);
});

test("a medium that is refused loses neither the lights nor the term sent with it", async () => {
  const { show, viewer, changes, refused, faults } = rig();
  await show("a");
  const no = {
    code: ErrorCode.ERROR_BAD_REQUEST,
    text: "no medium",
    hint: "",
    retryAfterMs: 0,
  };
  refused.push(new RelightError(no));
  changes.length = 0;
  const lamps = [{ ...FIRST_LAMP, env: "studio" }];
  viewer.show({ ...FIRST, model: "a", lamps, material: "{}", term: "multiple" });
  for (let i = 0; i < 40 && changes.length < 2; i++)
    await new Promise((done) => setTimeout(done, 100));
  const [first, second] = changes;
  expect(first?.fields).toContain("shade.material");
  expect(faults.map(({ text }) => text)).toEqual(["no medium"]);
  expect(second?.fields).toContain("lights");
  expect(second?.fields).toContain("shade.term");
  expect(second?.fields).not.toContain("shade.material");
  viewer.close();
});

test("a camera that turns before the first picture is drawn", async () => {
  const { show, viewer, changes, scene } = rig();
  await show("a");
  viewer.show({ ...scene("a"), orbit: { ...FIRST.orbit, azimuth: 90 } });
  await vi.waitFor(() => expect(changes.length).toBe(1), SLOW);
  expect(changes[0]?.fields).toEqual(["picture"]);
  expect(changes[0]?.picture?.camera.eye.x).toBeGreaterThan(1);
  viewer.close();
});

test("the first picture of a browser without WebGL has the size of the element", async () => {
  const { show, viewer, opened } = rig();
  await show("a");
  expect(opened[0]?.picture).toMatchObject({ width: 64, height: 48 });
  viewer.close();
});

// Bitmaps that are decoded when the test says; their name is the picture's text.
function decoder() {
  const waiting: (() => void)[] = [];
  vi.stubGlobal("createImageBitmap", async (blob: Blob) => {
    const of = await blob.text();
    await new Promise<void>((done) => waiting.push(done));
    return { of, width: 1, height: 1, close: () => undefined };
  });
  return async (n: number) => {
    await vi.waitFor(() => expect(waiting.length).toBe(n), SLOW);
    waiting.splice(0).forEach((done) => done());
    await new Promise((done) => setTimeout(done, 10));
  };
}
const picture = (frame: bigint, of: string) => ({
  message: create(ViewFrameSchema, { frame, image: {} }),
  payload: new TextEncoder().encode(of),
});

test("a picture that is decoded late is not drawn over another model", async () => {
  const { show, viewer, framed, drawn } = rig();
  const decode = decoder();
  await show("a");
  framed[0]?.(picture(1n, "a1"));
  await decode(1);
  framed[0]?.(picture(9n, "a9"));
  await show("b");
  await decode(1);
  framed[1]?.(picture(2n, "b2"));
  await decode(1);
  expect(drawn).toEqual(["a1", "b2"]);
  viewer.close();
  vi.unstubAllGlobals();
});

test("the picture goes with its model", async () => {
  const { show, viewer, framed, pictureCanvas } = rig();
  const decode = decoder();
  await show("a");
  framed[0]?.(picture(1n, "a1"));
  await decode(1);
  expect(pictureCanvas.hidden).toBe(false);
  framed[0]?.(picture(2n, "a2"));
  await show("");
  await decode(1);
  expect(pictureCanvas.hidden).toBe(true);
  viewer.close();
  vi.unstubAllGlobals();
});

test("words say whether the preview or a draft of the bake is drawn", async () => {
  const stage = new Proxy({}, { get: () => () => undefined }) as Stage; // it draws nothing
  const { show, viewer, framed, said } = rig([], ModelState.MODEL_BAKING, stage);
  await show("a");
  const words = (frame: bigint, draft: boolean) => {
    const message = create(ViewFrameSchema, { frame, equal: true, image: { cost: { draft } } });
    framed[0]?.({ message, payload: new Uint8Array(0) });
    return said.at(-1)?.why;
  };
  expect(words(1n, false)).toMatch(/^No bake yet/);
  expect(words(2n, true)).toMatch(/its draft/);
  expect(words(3n, false)).toMatch(/its draft/); // the bake itself, before the mesh is here
  viewer.close();
});

test("a still is of the model that is opened, and of none that was refused", async () => {
  const no = { code: ErrorCode.ERROR_NOT_FOUND, text: "no model", hint: "", retryAfterMs: 0 };
  const refusals: RelightError[] = [];
  const { show, viewer, scene, stills } = rig(refusals);
  await show("a");
  viewer.show(scene("b"));
  await viewer.still(ImageFormat.IMAGE_PNG);
  refusals.push(new RelightError(no));
  await show("c");
  await viewer.still(ImageFormat.IMAGE_PNG);
  expect(stills).toEqual(["b", "c"]);
  viewer.close();
});

test("lights that were refused are sent whole with the next change", async () => {
  const { show, viewer, changes, refused } = rig();
  await show("a");
  const no = { code: ErrorCode.ERROR_NOT_FOUND, text: "no light", hint: "", retryAfterMs: 0 };
  refused.push(new RelightError(no));
  changes.length = 0;
  const lamps = [{ ...FIRST_LAMP, env: "studio" }];
  const turned = [{ ...FIRST_LAMP, env: "studio", rotate: 30 }];
  viewer.show({ ...FIRST, model: "a", lamps });
  await new Promise((done) => setTimeout(done, 2000));
  expect(changes.length).toBe(1);
  viewer.show({ ...FIRST, model: "a", lamps: turned });
  await new Promise((done) => setTimeout(done, 2000));
  expect(changes[1]?.fields).toContain("lights");
  viewer.close();
});

// A viewer of a baked model of one triangle with factors of rank 1; the stage draws nothing. gain: the
// variant's albedo over the baked one. formats: color formats that the viewer asks for.
function bakedRig(gain?: { x: number; y: number; z: number }) {
  const formats: unknown[] = [];
  const asked: Type[] = [];
  const [sections, factors] = [new Uint8Array(84), new Uint8Array(84)];
  factors.set(new Uint8Array(Uint32Array.from([3, 1, 0, 1, 2]).buffer)); // 3 vertices, rank 1
  const tensor = {
    term: Term.MULTIPLE,
    nCluster: 1,
    orderOffset: 8n,
    uOffset: 20n,
    uBytes: 64n,
  };
  const state = ModelState.MODEL_READY;
  const answers: Partial<Record<Type, [unknown, Uint8Array?]>> = {
    [Type.Info]: [create(ModelInfoSchema, { model: "a", state })],
    [Type.Geometry]: [
      create(GeometryAnswerSchema, {
        nVertex: 3,
        nTriangle: 1,
        normalsOffset: 36n,
        trianglesOffset: 72n,
        blocks: [{ nVertex: 3, nTriangle: 1, ...(gain ? { gain } : {}) }],
      }),
      sections,
    ],
    [Type.Factors]: [
      create(FactorsAnswerSchema, { factors: 7n, nVertex: 3, tensors: [tensor] }),
      factors,
    ],
  };
  let framed: Framed | undefined;
  interface Set {
    fields: string[];
    options?: { colorFormat: ColorFormat };
  }
  const client = {
    hello: {},
    has: (feature: string) => feature === "coefficients",
    notify: () => undefined,
    request: (type: Type, _: unknown, init: { state: Set }) => {
      asked.push(type);
      if (type === Type.ViewSet && init.state.fields.includes("options.color_format"))
        formats.push(init.state.options?.colorFormat);
      const [message = {}, payload = new Uint8Array(0)] = answers[type] ?? [];
      return Promise.resolve({ message, payload });
    },
    stream: (...all: unknown[]) => {
      framed = all[4] as Framed;
      return 1n;
    },
  };
  const stage = new Proxy({}, { get: () => () => undefined }) as Stage;
  const canvas = fakeCanvas();
  const none = () => undefined;
  const viewer = new Viewer(
    client as unknown as Client,
    { canvas, pictureCanvas: canvas },
    stage,
    { status: none, info: none, fine: none, fault: (error) => formats.push(error) },
  );
  viewer.show({ ...FIRST, model: "a", lamps: [{ ...FIRST_LAMP, env: "constant" }] });
  const frame = (init: MessageInitShape<typeof ViewFrameSchema>) =>
    framed?.({ message: create(ViewFrameSchema, init), payload: new Uint8Array(0) });
  return { viewer, formats, asked, frame };
}

// The first n color formats.
async function formatsOf(gain: Parameters<typeof bakedRig>[0], n: number) {
  const { viewer, formats, frame } = bakedRig(gain);
  await vi.waitFor(() => expect(viewer.shape).not.toBeNull(), SLOW);
  await import("../src/scene/factors");
  await new Promise((done) => setTimeout(done, 50));
  frame({ frame: 1n, equal: true });
  await new Promise((done) => setTimeout(done, 50));
  await vi.waitFor(() => expect(formats.length).toBeGreaterThanOrEqual(n), SLOW);
  viewer.close();
  return formats;
}

// Coefficients are multiplied with the factors of the albedo that was baked.
test("coefficients are asked for where the albedo is the one that was baked", async () => {
  expect(await formatsOf(undefined, 1)).toEqual([ColorFormat.COLOR_COEFFICIENTS]);
  expect(await formatsOf({ x: 1, y: 1, z: 1 }, 1)).toEqual([ColorFormat.COLOR_COEFFICIENTS]);
  expect(await formatsOf({ x: 1, y: 0.5, z: 1 }, 0)).toEqual([]);
});

test("a model that was replaced by one of another mesh is fetched again", async () => {
  const { viewer, asked, frame } = bakedRig();
  await vi.waitFor(() => expect(viewer.shape).not.toBeNull(), SLOW);
  const meshes = () => asked.filter((type) => type === Type.Geometry).length;
  frame({ frame: 1n, colors: { nVertex: 3 } });
  await new Promise((done) => setTimeout(done, 50));
  expect(meshes()).toBe(1);
  frame({ frame: 2n, colors: { nVertex: 4 } });
  await vi.waitFor(() => expect(meshes()).toBe(2), SLOW);
  viewer.close();
});
