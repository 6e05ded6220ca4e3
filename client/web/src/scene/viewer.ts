// SPDX-License-Identifier: MIT
// A viewer: one model of a daemon in one element of a page. It follows a SceneState: what the
// daemon has to compute goes out as changes of a view, and the rest is drawn here. A model
// without a bake, and a browser without WebGL 2, get pictures of the daemon instead. Above 600
// lines: for each change of the state one function decides what the daemon computes and what is
// drawn here.
import {
  ColorFormat,
  Engine,
  FactorsAnswerSchema,
  FactorsRequestSchema,
  ImageAnswerSchema,
  type ImageFormat,
  ImageRequestSchema,
  InfoRequestSchema,
  ModelInfoSchema,
  ModelState,
  type ColorsAnswer,
  type Cost,
  type ModelInfo,
  type Outgoing,
  type Progress,
  type ViewFrame,
} from "../gen/relight_pb";
import type { Client } from "../protocol/client";
import {
  dipoleErrorOf,
  isByWalks,
  placesOf,
  type DipoleError,
  type ErrorPlaces,
} from "./error-map";
import { busyMs, whenFree } from "../protocol/busy";
import { RelightError } from "../protocol/errors";
import { Type } from "../protocol/frame";
import { meanTransmittance, parseMedium, surfaceOf } from "../state/material";
import { TONES, type SceneState } from "../state/scene-state";
import { frameOfBox, place, type Frame, type Placed } from "./camera";
import { BakeWatch } from "./bake-watch";
import type { Mesh } from "./geometry";
import { LightView, type ViewChange, type ViewInit } from "./light-view";
import { LEVELS, MOST_DELAY_MS, MOST_OUTSTANDING } from "./pace";
import { lampsOf, lightMessages } from "./lights";
import type { CoarseOrder, expanded } from "./coarse-order";
import type { Factors } from "./factors";
import { fetchImages, fetchMesh, type MeshSource } from "./mesh-source";
import type { Stage } from "./stage";
import { Told, isCoefficients, pictureOf, same, shadeOf, type Wanted } from "./view-change";

export interface Status {
  /** mesh: drawn here; pictures: drawn by the daemon. */
  mode: "none" | "mesh" | "pictures";
  /** Why pictures, in words; empty: the bake is drawn. */
  why: string;
  stream: string;
  engine: string;
  /** Relative RMSE against the reference; 0: unknown. */
  errorBound: number;
  latencyMs: number;
  note: string;
  frames: number;
  progress: Progress | null;
}
export const NO_STATUS: Status = {
  mode: "none",
  why: "",
  stream: "",
  engine: "",
  errorBound: 0,
  latencyMs: 0,
  note: "",
  frames: 0,
  progress: null,
};

export interface ViewerEvents {
  status: (status: Status) => void;
  info: (info: ModelInfo | null) => void;
  /** A request that failed; the picture stays as it was. again: it is repeated by itself. */
  fault: (error: Error, again?: boolean) => void;
  /** Called when an earlier fault has ended. */
  fine: () => void;
}

const ENGINES: Record<number, string> = {
  [Engine.REFERENCE]: "reference",
  [Engine.WAVELET]: "wavelet",
  [Engine.POLYNOMIAL]: "polynomial",
  [Engine.JOINT]: "joint",
  [Engine.SPLAT]: "splat",
  [Engine.TANGENT]: "tangent",
  [Engine.TEXTURE]: "texture",
  [Engine.HYBRID]: "hybrid",
};

// What is drawn of a model that is not baked.
const NO_BAKE = "No bake yet: the daemon draws a preview.";
const DRAFT = "The bake is not done: the daemon draws its draft.";

export class Viewer {
  readonly canvas: HTMLCanvasElement;
  readonly pictureCanvas: HTMLCanvasElement;
  /** null: no WebGL 2, or not loaded yet. */
  stage: Stage | null = null;
  private readonly client: Client;
  private readonly events: ViewerEvents;
  private state: SceneState | null = null;
  private told: Told | null = null; // of the view
  private lit = ""; // lamps that the stage has
  private info: ModelInfo | null = null;
  private infoOf = ""; // the name or id in the state by which it was asked for
  private mesh: Mesh | null = null;
  private errorsOf: {
    info: ModelInfo | null;
    mesh: Mesh | null;
    places: ErrorPlaces | null;
    dipole: DipoleError | null;
  } = { info: null, mesh: null, places: null, dipole: null };
  private maps = 0; // meshes whose maps are on the way
  private factors: Factors | null = null; // null: colours come as they are
  private awaitsFactors = false; // first colours are to come soon: without planes of exit
  private order: CoarseOrder | null = null; // of the bake's vertices, on a slow link
  private ordering = false; // it is on the way, or there is none
  private frame: Frame | null = null;
  private view: LightView | null = null;
  private pictures = false; // the view draws pictures, its first one may be on the way
  // The model is opened anew when its bake is done. The picture stays until the first colours are there.
  private readonly bake: BakeWatch;
  private opening = 0; // grows with every opening: answers of an older one are dropped
  private status: Status = NO_STATUS;
  private pictureFrame = 0n;
  private outgoing: Outgoing[] = []; // of coefficients, and of colours in parts
  private readonly noWebGL: boolean;
  private readonly over = new AbortController();

  constructor(
    client: Client,
    host: { canvas: HTMLCanvasElement; pictureCanvas: HTMLCanvasElement },
    stage: Stage | null,
    events: ViewerEvents,
  ) {
    this.client = client;
    this.canvas = host.canvas;
    this.pictureCanvas = host.pictureCanvas;
    this.stage = stage;
    this.noWebGL = stage === null;
    // A browser, on phones often, takes the WebGL context from a page in the background. What the page
    // computed on the GPU is lost then; a new frame brings it back.
    this.canvas.addEventListener("webglcontextrestored", () => this.changed(), {
      signal: this.over.signal,
    });
    this.events = events;
    this.bake = new BakeWatch(client, {
      progress: (progress) => this.setStatus({ ...this.status, progress }),
      ended: () => void this.open(),
    });
  }

  // ---- the state

  /** Follows a state; a change that only moves the camera costs the daemon nothing. */
  show(state: SceneState): void {
    const old = this.state;
    this.state = state;
    if (state.model !== old?.model || state.variant !== old.variant) {
      void this.open();
      return;
    }
    this.update(old);
  }

  private update(old: SceneState | null): void {
    const { state } = this;
    if (!state || !this.info) return;
    this.applyLook(state);
    this.applyCamera(state);
    const lights = JSON.stringify(state.lamps);
    if (this.stage && lights !== this.lit) void this.applyLamps(state, lights);
    const changed =
      !same(old?.lamps, state.lamps) ||
      old?.material !== state.material ||
      !same(old.materials, state.materials) ||
      old.term !== state.term ||
      (this.pictures && !same(old, state));
    if (changed) this.changed();
  }

  private applyLook(state: SceneState): void {
    const { stage } = this;
    if (!stage) return;
    const { eta, roughness } = surfaceOf(state.material || this.info?.material || "{}");
    const total = state.term === "total";
    const divisor = total ? meanTransmittance(eta) : 1;
    stage.setMedium(
      this.outgoing.length ? this.outgoing : [{ eta, roughness, divisor, viewSlope: 0 }],
      { transmission: total, reflection: total, look: state.term !== "irradiance" },
    );
    stage.showThickness(state.heat === "thickness" ? this.thickestMm : 0);
    if (state.heat === "dipole") stage.showErrors(this.dipoleError?.places ?? null, 0);
    else
      stage.showErrors(
        state.heat === "error" ? this.errorPlaces : null,
        Math.max(this.mostError, 1e-6),
      );
    stage.setLook({
      exposure: state.exposure,
      tone: TONES.indexOf(state.tone),
      plain: state.background === "environment" ? null : state.background,
    });
  }

  private applyCamera(state: SceneState): void {
    if (this.frame) this.stage?.setCamera(this.placed(state), this.frame.radius);
  }

  /** The surface of the model that is shown; null: it is not here. */
  get shape(): Mesh | null {
    if (this.status.mode !== "pictures") return this.mesh;
    return this.surfaceOf === this.shownKey ? this.surface : null;
  }
  private get shownKey(): string {
    return this.info ? `${this.info.model} ${this.info.generation}` : "";
  }
  private surface: Mesh | null = null; // of a model that the daemon draws
  private surfaceOf = "";
  /** Fetches the surface of a model that the daemon draws, so that it can be pointed at. */
  async bringShape(): Promise<void> {
    const { info, shownKey: key } = this;
    if (this.status.mode !== "pictures" || !info || key === this.surfaceOf) return;
    this.surfaceOf = key;
    this.surface = null;
    try {
      const { mesh } = await whenFree(
        () => fetchMesh(this.client, info.model, "", false),
        () => key === this.surfaceOf,
      );
      if (key !== this.surfaceOf) return;
      this.surface = mesh;
      this.setStatus({ ...this.status });
    } catch (error) {
      this.events.fault(error as Error); // it is fetched again when the model is opened again
    }
  }
  /** The thickness that is drawn brightest: half of the model's diagonal. */
  get thickestMm(): number {
    return this.frame && this.mesh ? this.frame.radius * this.mesh.mmPerUnit : 0;
  }
  /** Where the bake errs; null: nobody measured it. */
  get errorPlaces(): ErrorPlaces | null {
    return this.measured().places;
  }
  /** Where the dipole errs; null: the bake was not compared with walks. */
  get dipoleError(): DipoleError | null {
    return this.measured().dipole;
  }
  /** Whether the bake is by random walks. */
  get byWalks(): boolean {
    return isByWalks(this.info?.settings ?? "");
  }
  private measured() {
    const { info, mesh } = this;
    if (info !== this.errorsOf.info || mesh !== this.errorsOf.mesh) {
      const places = info && mesh ? placesOf(info.errors, mesh.nVertex) : null;
      const dipole = info && mesh ? dipoleErrorOf(info.errors, mesh.nVertex) : null;
      this.errorsOf = { info, mesh, places, dipole };
    }
    return this.errorsOf;
  }
  /** The error that is drawn brightest: the largest that was measured. */
  get mostError(): number {
    return this.errorPlaces?.error.reduce((a, b) => Math.max(a, b), 0) ?? 0;
  }
  /** The frame of the camera; null: it is not known yet. */
  get framed(): Frame | null {
    return this.frame;
  }

  /** The camera of a state, in the model's own units. */
  placed(state: SceneState): Placed {
    const { canvas } = this;
    const aspect = canvas.clientWidth / Math.max(1, canvas.clientHeight) || 1;
    return place(this.frame ?? { centre: [0, 0, 0], radius: 1 }, state.orbit, aspect);
  }

  private async applyLamps(state: SceneState, lights: string): Promise<void> {
    this.lit = lights;
    try {
      const lamps = await lampsOf(this.client, state.lamps);
      if (this.lit === lights) this.stage?.setLamps(lamps);
    } catch (error) {
      if (this.lit === lights) this.lit = "";
      this.failed(error);
    }
  }

  // ---- opening

  /** Opens the model of the state anew: after a choice, a connection, or the end of a bake. */
  open(): Promise<void> {
    this.opened = this.openNow();
    return this.opened;
  }
  private opened = Promise.resolve();

  private async openNow(): Promise<void> {
    const turn = ++this.opening;
    if (!this.surface) this.surfaceOf = "";
    const current = () => turn === this.opening;
    this.closeView();
    const { state } = this;
    if (!state?.model || !this.client.hello) {
      if (!state?.model) this.forget();
      return;
    }
    try {
      const { message: info } = await this.client.request(
        Type.Info,
        InfoRequestSchema,
        { model: state.model },
        ModelInfoSchema,
      );
      if (!current()) return;
      this.info = info;
      this.infoOf = state.model;
      this.events.info(info);
      this.frameBox(info);
      if (this.stage && isBaked(info)) await this.openMesh(info, current);
      else await this.openView(info, false, current);
      if (current()) this.bake.follow(info);
      if (current()) this.events.fine();
    } catch (error) {
      if (current()) this.failed(error);
    }
  }

  /** The models as the daemon lists them now: somebody else may have begun the bake of the one that is
   * shown, or it may have ended unseen. */
  async listed(models: readonly ModelInfo[]): Promise<void> {
    await this.opened;
    const now = models.find(({ model }) => model === this.info?.model);
    if (!now || !this.info || this.over.signal.aborted) return;
    this.bake.follow(now);
    if (isBaked(now) && !isBaked(this.info)) void this.open();
  }

  // A model that a busy daemon refused, or a change of its view, is opened anew when the daemon says:
  // a view that is opened has the whole state.
  private failed(error: unknown): void {
    const wait = busyMs(error);
    this.events.fault(error as Error, wait !== null);
    if (wait === null) return;
    const turn = this.opening;
    setTimeout(() => {
      if (turn === this.opening) void this.open();
    }, wait);
  }

  private forget(): void {
    this.info = null;
    this.mesh = null;
    this.frame = null;
    this.stage?.setMesh(null);
    this.pictureCanvas.hidden = true;
    this.setStatus(NO_STATUS);
    this.events.info(null);
  }

  private frameBox(info: ModelInfo): void {
    const { boxMin, boxMax, mmPerUnit } = info;
    if (!boxMin || !boxMax) return;
    const k = 1 / (mmPerUnit || 1);
    this.frame = frameOfBox(
      [boxMin.x * k, boxMin.y * k, boxMin.z * k],
      [boxMax.x * k, boxMax.y * k, boxMax.z * k],
    );
  }

  private async openMesh(info: ModelInfo, current: () => boolean): Promise<void> {
    const { stage } = this;
    const variant = this.state?.variant ?? "";
    const known =
      this.mesh &&
      this.mesh.generation === info.generation &&
      this.meshOf === info.model &&
      this.meshVariant === variant;
    if (!stage) return;
    const source = known ? null : await fetchMesh(this.client, info.model, variant);
    if (!current()) return;
    if (source) {
      this.frame ??= source.mesh.frame;
      this.mesh = source.mesh;
      this.meshOf = info.model;
      this.meshVariant = variant;
      this.factors?.dispose();
      this.factors = null;
      this.order = null;
      this.ordering = false;
      stage.setMesh(source.mesh);
    }
    this.awaitsFactors = !this.factors && this.coefficients && this.client.has("coefficients");
    await this.openView(info, true, current);
    if (!current()) return;
    void this.fetchFactors(info, current);
    if (source) void this.fetchMaps(source, info.model);
  }
  private meshOf = "";
  private meshVariant = "";

  // Maps follow the mesh: the first picture does not wait for them.
  private async fetchMaps(source: MeshSource, model: string): Promise<void> {
    if (!source.images.size) return;
    this.maps++;
    try {
      const images = await whenFree(() => fetchImages(this.client, model, source.images));
      if (this.mesh === source.mesh) this.stage?.setMaps(images);
    } catch (error) {
      this.events.fault(error as Error);
    } finally {
      this.maps--;
    }
  }

  // Colours come at once; when the factors are there the view goes over to coefficients. A
  // model without factored transport stays with colours.
  private async fetchFactors(info: ModelInfo, current: () => boolean): Promise<void> {
    if (!this.awaitsFactors) return;
    try {
      const { message, payload } = await whenFree(
        () =>
          this.client.request(
            Type.Factors,
            FactorsRequestSchema,
            { model: info.model, exits: true },
            FactorsAnswerSchema,
          ),
        current,
      );
      if (!current()) return;
      const { Factors } = await import("./factors");
      this.factors = new Factors(message, payload);
    } catch (error) {
      if (!(error instanceof RelightError)) this.events.fault(error as Error);
    }
    if (!current()) return;
    this.awaitsFactors = false;
    if (this.state && this.format(this.state) !== this.told?.format) this.changed();
  }

  /** Colours or coefficients, for a comparison; coefficients where the daemon has them. */
  coefficients = true;
  useCoefficients(on: boolean): void {
    this.coefficients = on;
    this.changed();
  }

  private format(state: SceneState): ColorFormat {
    // Coefficients are of the albedo that was baked; colours are of the variant's.
    const factored =
      this.factors && this.coefficients && state.term !== "irradiance" && !this.mesh?.gained;
    if (factored)
      return this.client.has("coefficients-packed")
        ? ColorFormat.COLOR_COEFFICIENTS_PACKED
        : ColorFormat.COLOR_COEFFICIENTS;
    // Planes of a phase function and of exit have negative numbers, which RGB9E5 has not.
    const exits = this.info?.exitPlanes && !this.awaitsFactors;
    return exits || !this.scattersEvenly(state)
      ? ColorFormat.COLOR_F16
      : ColorFormat.COLOR_RGB9E5;
  }

  private scattersEvenly(state: SceneState): boolean {
    const own = this.info?.media.length ? this.info.media : [this.info?.material ?? "{}"];
    const all = [
      ...(state.material ? [state.material] : own),
      ...Object.values(state.materials),
    ];
    return all.every((text) => parseMedium(text)?.g.every((g) => g === 0) ?? true);
  }

  private async openView(
    info: ModelInfo,
    colors: boolean,
    current: () => boolean,
  ): Promise<void> {
    const { state } = this;
    if (!state) return;
    const { lights, payload } = await lightMessages(this.client, state.lamps);
    if (!current()) return;
    this.pictures = !colors;
    const wanted = this.wanted(state, !colors, 0);
    const first: ViewInit = {
      lights,
      shade: shadeOf(state),
      options: { ...wanted.options, phases: true, window: MOST_OUTSTANDING, maxFps: 60 },
      ...(wanted.picture ? { picture: wanted.picture } : {}),
    };
    this.told = new Told(wanted);
    const why = colors
      ? ""
      : this.noWebGL
        ? "This browser has no WebGL 2: the daemon draws the pictures."
        : info.stale
          ? "The vertices moved: pictures are drawn without the bake."
          : NO_BAKE;
    let drafted = false; // a draft of the bake has answered
    this.view = new LightView(this.client, info.model, colors, first, payload, {
      frame: (frame, bytes, latency) => {
        drafted ||= frame.image?.cost?.draft ?? false;
        const now = drafted && why === NO_BAKE ? DRAFT : why;
        this.received(frame, bytes, latency, colors, now);
      },
      error: (error) => this.failed(error),
      busy: () => colors && (this.stage?.waits ?? false),
      leastLevel: () => (colors ? (this.stage?.leastLevel ?? 0) : 0),
    });
    if (this.stage) this.stage.onBegun = () => this.view?.goOn();
    this.view.useLevels(!colors || isCoefficients(wanted.options.colorFormat));
    this.update(state);
  }

  private closeView(): void {
    this.view?.close();
    this.view = null;
    this.told = null;
    this.pictureFrame = 0n;
  }

  // ---- colours and pictures of the daemon

  // Pixels of the picture that is shown, at a share of its resolution. Its own canvas has no size
  // until the first one is there.
  private pictureSize(share = 1): { width: number; height: number } {
    const ratio = share * Math.min(globalThis.devicePixelRatio || 1, 1.5);
    const side = (length: number) => Math.max(16, Math.min(1600, Math.round(length * ratio)));
    return { width: side(this.canvas.clientWidth), height: side(this.canvas.clientHeight) };
  }

  // What the view is to show of a state, in frames of a level (LEVELS).
  private wanted(state: SceneState, pictures: boolean, level: number): Wanted {
    const { rank = 0, side } = LEVELS[level] ?? {};
    const size = this.pictureSize(side);
    const colorFormat = this.format(state);
    const mostRank = isCoefficients(colorFormat) ? rank : 0;
    // Planes of exit are most of the coefficients: coarse frames are without them.
    const options = { colorFormat, mostRank, exits: !mostRank, coarse: this.order !== null };
    const picture = pictures ? pictureOf(state, this.placed(state), size) : null;
    return { state, picture, options };
  }

  private changed(): void {
    this.view?.set((level) => this.change(level));
  }

  // What differs between the state and the view, in as few bytes as it takes.
  private async change(level: number): Promise<ViewChange> {
    const { state, told } = this;
    if (!state || !told) return { state: {}, fields: ["shade.term"] };
    const wanted = this.wanted(state, this.pictures, level);
    if (!wanted.picture && wanted.options.colorFormat !== told.format)
      this.view?.useLevels(isCoefficients(wanted.options.colorFormat));
    return told.change(this.client, wanted, () => {
      if (told === this.told) this.changed();
    });
  }

  private received(
    frame: ViewFrame,
    payload: Uint8Array,
    latencyMs: number,
    colors: boolean,
    why: string,
  ): void {
    const cost = frame.colors?.cost ?? frame.image?.cost;
    if (frame.colors && this.stage) {
      this.drawColors(frame.colors, payload);
      // The picture goes when the mesh has been drawn, so that nothing flickers between them.
      this.stage.onDrawn = () => {
        this.pictureCanvas.hidden = true;
        if (this.stage) this.stage.onDrawn = null;
      };
    }
    if (frame.image) void this.drawPicture(frame, payload);
    const late = latencyMs > MOST_DELAY_MS && !this.awaitsFactors;
    if (late && frame.colors && !frame.colors.coefficients) void this.wantOrder();
    this.events.fine();
    this.setStatus({
      ...this.status,
      ...costOf(cost),
      mode: colors ? "mesh" : "pictures",
      why,
      stream: !colors ? "pictures, JPEG" : this.stream(frame),
      latencyMs,
      frames: this.status.frames + 1,
    });
  }

  private drawColors(colors: ColorsAnswer, payload: Uint8Array): void {
    const { stage, factors, state, mesh } = this;
    const light = colors.coefficients;
    if (!stage || !state || !mesh) return;
    if (mesh.nVertex !== colors.nVertex) {
      this.openAnew();
      return;
    }
    this.outgoing = light?.outgoing ?? colors.outgoing;
    if (!light) this.drawVertexColors(stage, colors, payload);
    else if (factors && light.factors === factors.hash)
      stage.light((vertices) =>
        factors.multiply(stage.renderer, light, colors, payload, vertices),
      );
    else this.openAnew();
    this.applyLook(state);
  }

  // The file of the model was replaced: the mesh and the factors of its new bake are fetched.
  private openAnew(): void {
    this.meshOf = "";
    void this.open();
  }

  private drawVertexColors(stage: Stage, colors: ColorsAnswer, payload: Uint8Array): void {
    const { order, expand } = this;
    if (!colors.nCoarse) stage.takeColors(colors, payload);
    else if (order && expand && order.hash === colors.coarseOrder)
      stage.takeColors(colors, payload, expand(order, colors, payload));
    else {
      this.order = null; // of another bake: fetched again, and full frames until then
      this.ordering = false;
      this.changed();
    }
  }

  // Colours that come late are to be of fewer vertices from now on. A model without an order
  // stays with whole ones.
  private async wantOrder(): Promise<void> {
    const { info } = this;
    if (this.ordering || this.order || !info || !this.client.has("coarse")) return;
    this.ordering = true;
    const mesh = this.mesh;
    try {
      const coarse = await import("./coarse-order");
      const order = await whenFree(
        () => coarse.fetchOrder(this.client, info.model),
        () => this.mesh === mesh,
      );
      if (this.mesh !== mesh) return;
      this.expand = coarse.expanded;
      this.order = order;
      this.changed();
    } catch (error) {
      if (!(error instanceof RelightError)) this.events.fault(error as Error);
    }
  }
  private expand: typeof expanded | null = null;

  private stream(frame: ViewFrame): string {
    const format = frame.colors?.format;
    return isCoefficients(format)
      ? "coefficients"
      : format === ColorFormat.COLOR_F16
        ? "colours, halves"
        : "colours, RGB9E5";
  }

  private async drawPicture(frame: ViewFrame, payload: Uint8Array): Promise<void> {
    if (frame.equal) return;
    const { view } = this;
    const bitmap = await createImageBitmap(new Blob([payload.slice()], { type: "image/jpeg" }));
    if (view !== this.view || frame.frame < this.pictureFrame) return; // decoded too late
    this.pictureFrame = frame.frame;
    const canvas = this.pictureCanvas;
    if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
      canvas.width = bitmap.width;
      canvas.height = bitmap.height;
    }
    canvas.getContext("2d")?.drawImage(bitmap, 0, 0);
    canvas.hidden = false;
    bitmap.close();
  }

  private setStatus(status: Status): void {
    this.status = status;
    this.events.status(status);
  }

  // ---- the bake

  async cancelBake(): Promise<void> {
    const job = this.status.progress?.job;
    if (job) await this.bake.cancel(job);
  }

  // ---- pictures of the daemon

  /** The daemon's picture of the state as it is, once its model is open. */
  async still(
    format: ImageFormat,
    size?: { width: number; height: number },
    state = this.state,
  ): Promise<{ bytes: Uint8Array; width: number; height: number }> {
    if (!state) throw new Error("no model is shown");
    await this.opened;
    const model = (this.infoOf === state.model && this.info?.model) || state.model;
    const { lights, payload } = await lightMessages(this.client, state.lamps);
    const drawn = pictureOf(state, this.placed(state), size ?? this.pictureSize());
    const picture = { ...drawn, format, quality: 92, samples: 8 };
    const answer = await this.client.request(
      Type.Image,
      ImageRequestSchema,
      { model, lights, shade: shadeOf(state), picture },
      ImageAnswerSchema,
      payload,
    );
    return {
      bytes: answer.payload,
      width: answer.message.width,
      height: answer.message.height,
    };
  }

  /** Whether a change waits until the GPU has finished the frame before. */
  get busy(): boolean {
    return this.stage?.waits ?? false;
  }

  /** Whether the newest state is drawn: no frame is awaited, and the GPU is idle. */
  get settled(): boolean {
    const { view, stage } = this;
    return (
      view !== null && view.idle && !this.maps && this.lit !== "" && (!stage || stage.rests)
    );
  }

  /** After a change of the element's size. */
  resized(): void {
    const ratio = Math.min(globalThis.devicePixelRatio || 1, 2);
    this.stage?.resize(
      Math.max(1, Math.round(this.canvas.clientWidth * ratio)),
      Math.max(1, Math.round(this.canvas.clientHeight * ratio)),
    );
    if (this.state) this.applyCamera(this.state);
    if (this.pictures) this.changed();
  }

  /** Closes for good: the browser gets the WebGL context of the canvas back at once. */
  end(): void {
    this.close();
    const context = this.stage?.renderer.getContext();
    context?.getExtension("WEBGL_lose_context")?.loseContext();
  }

  close(): void {
    this.over.abort();
    this.opening++;
    this.closeView();
    this.bake.close();
    this.factors?.dispose();
    this.factors = null;
    this.stage?.dispose();
  }
}

const isBaked = ({ state, stale }: ModelInfo) =>
  (state === ModelState.MODEL_READY || state === ModelState.MODEL_UNLOADED) && !stale;

function costOf(cost: Cost | undefined): Partial<Status> {
  if (!cost) return {};
  return { engine: ENGINES[cost.engine] ?? "", errorBound: cost.errorBound, note: cost.note };
}
