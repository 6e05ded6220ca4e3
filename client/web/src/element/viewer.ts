// SPDX-License-Identifier: MIT
// <relight-viewer>: a model of a relightd in any page, one element without a page around it.
// Attributes and their meaning are in client/web/README.md.
import { ImageFormat, type ModelInfo } from "../gen/relight_pb";
import { Client, type ConnectionState } from "../protocol/client";
import { explain } from "../protocol/errors";
import { clampOrbit, START, type Orbit, type Vec3 } from "../scene/camera";
import { attachGestures } from "../scene/gestures";
import { Viewer, type Status } from "../scene/viewer";
import {
  FIRST,
  FIRST_LAMP,
  TERMS,
  TONES,
  type LampState,
  type SceneState,
} from "../state/scene-state";

const STYLE = `
:host { display: block; position: relative; width: 400px; height: 300px; overflow: hidden; contain: content; }
:host([hidden]) { display: none; }
.stage { position: absolute; inset: 0; outline-offset: -3px; }
:host(:not([interaction="none"])) .stage { cursor: grab; touch-action: none; }
canvas, img { position: absolute; inset: 0; width: 100%; height: 100%; display: block; }
img { object-fit: cover; }
[hidden] { display: none !important; }
.message { position: absolute; inset: auto 0 0 0; margin: 0; padding: 8px 12px; font: 13px/1.4 system-ui, sans-serif;
  color: #fff; background: rgb(20 20 24 / 0.82); }
.progress { position: absolute; inset: auto 0 0 0; height: 4px; width: 100%; appearance: none; border: 0;
  background: rgb(128 128 128 / 0.4); accent-color: #f2b277; }
`;

const ATTRIBUTES = [
  "server",
  "token",
  "model",
  "environment",
  "rotate",
  "tilt",
  "intensity",
  "exposure",
  "tone",
  "term",
  "material",
  "variant",
  "background",
  "camera-orbit",
  "auto-rotate",
  "interaction",
  "poster",
  "alt",
] as const;

/** Events of <relight-viewer>. */
export interface RelightViewerEvents {
  /** The first light was drawn. */
  load: CustomEvent<{ model: string; name: string }>;
  error: CustomEvent<{ title: string; text: string; remedy: string }>;
  /** Engine, error, latency and progress of a bake changed. */
  status: CustomEvent<Status>;
  "camera-change": CustomEvent<Orbit>;
  "light-change": CustomEvent<{ rotate: number; tilt: number }>;
}

const degrees = (text: string) => parseFloat(text); // "45deg" and "45"

export class RelightViewerElement extends HTMLElement {
  static readonly observedAttributes: readonly string[] = ATTRIBUTES;
  private readonly root = this.attachShadow({ mode: "open" });
  private readonly stage = document.createElement("div");
  private readonly canvas = document.createElement("canvas");
  private readonly picture = document.createElement("canvas");
  private readonly poster = document.createElement("img");
  private readonly message = document.createElement("p");
  private readonly bar = document.createElement("progress");
  private client: Client | null = null;
  private viewer: Viewer | null = null;
  private state: SceneState = FIRST;
  private observer: ResizeObserver | null = null;
  private detach: (() => void) | null = null;
  private turning = 0;
  private shown = false;

  constructor() {
    super();
    const style = new CSSStyleSheet();
    style.replaceSync(STYLE);
    this.root.adoptedStyleSheets = [style];
    this.stage.className = "stage";
    this.canvas.part.add("canvas");
    this.picture.part.add("picture");
    this.picture.hidden = true;
    this.poster.part.add("poster");
    this.poster.alt = "";
    this.poster.hidden = true;
    this.message.className = "message";
    this.message.part.add("message");
    this.message.setAttribute("role", "status");
    this.message.hidden = true;
    this.bar.className = "progress";
    this.bar.part.add("progress");
    this.bar.setAttribute("aria-label", "Bake");
    this.bar.hidden = true;
    this.stage.append(this.canvas, this.picture, this.poster);
    this.root.append(this.stage, this.message, this.bar);
  }

  connectedCallback(): void {
    this.readAttributes();
    const client = new Client(this.address(), {
      token: this.getAttribute("token") ?? "",
      name: "relight-viewer 0.1.0",
      changed: (state) => this.connectionChanged(state),
    });
    this.client = client;
    client.lookAt(this.state.model);
    void this.makeViewer(client);
    this.takeHands();
    if (this.hasAttribute("auto-rotate")) this.turn();
  }

  // An element without interaction leaves wheel, fingers and keys to the page round it: it is a picture.
  private takeHands(): void {
    this.detach?.();
    this.detach = null;
    const isPicture = this.interaction === "none";
    this.stage.setAttribute("role", isPicture ? "img" : "application");
    if (isPicture) this.stage.removeAttribute("tabindex");
    else this.stage.tabIndex = 0;
    if (isPicture) return;
    this.detach = attachGestures(this.stage, {
      orbit: () => this.state.orbit,
      setOrbit: (orbit) => {
        if (this.interaction === "orbit") this.turnBy(orbit);
        else this.dragLight(orbit);
      },
      turnLight: (rotate, tilt) => this.turnLight(rotate, tilt),
      reset: () => this.resetCamera(),
      commit: () => undefined,
      busy: () => this.viewer?.busy ?? false,
    });
  }

  disconnectedCallback(): void {
    cancelAnimationFrame(this.turning);
    this.detach?.();
    this.observer?.disconnect();
    this.viewer?.close();
    this.client?.close();
    this.viewer = null;
    this.client = null;
    this.shown = false;
  }

  attributeChangedCallback(name: string): void {
    if (!this.client) return;
    if (name === "token") this.client.useToken(this.getAttribute("token") ?? "");
    else if (name === "server") {
      this.disconnectedCallback();
      this.connectedCallback();
    } else if (name === "interaction") this.takeHands();
    else if (name === "auto-rotate") {
      cancelAnimationFrame(this.turning);
      if (this.hasAttribute("auto-rotate")) this.turn();
    } else {
      this.readAttributes(name);
      this.client.lookAt(this.state.model);
      this.viewer?.show(this.state);
    }
  }

  // ---- properties and methods

  get cameraOrbit(): Orbit {
    return this.state.orbit;
  }
  set cameraOrbit(orbit: Orbit) {
    this.state = { ...this.state, orbit: clampOrbit(orbit) };
    this.viewer?.show(this.state);
    this.tell("camera-change", this.state.orbit);
  }
  /** "orbit" (Shift turns the light), "light" (a drag turns it), or "none". */
  get interaction(): "orbit" | "light" | "none" {
    const word = this.getAttribute("interaction");
    return word === "light" || word === "none" ? word : "orbit";
  }
  resetCamera(): void {
    this.cameraOrbit = this.orbitOf(this.getAttribute("camera-orbit"));
  }
  /** Degrees by which the light turns about +y, and tilts. */
  turnLight(rotate: number, tilt = 0): void {
    const lamps = this.state.lamps.map((lamp) => ({
      ...lamp,
      rotate: (lamp.rotate + rotate + 720) % 360,
      tilt: Math.min(90, Math.max(-90, lamp.tilt + tilt)),
    }));
    this.state = { ...this.state, lamps };
    this.viewer?.show(this.state);
    this.tell("light-change", { rotate: lamps[0]?.rotate ?? 0, tilt: lamps[0]?.tilt ?? 0 });
  }
  /** A still of the present scene, rendered by the daemon. */
  async toBlob(type: "image/png" | "image/jpeg" | "image/x-exr" = "image/png"): Promise<Blob> {
    if (!this.viewer) throw new Error("the element is not connected");
    const formats = {
      "image/png": ImageFormat.IMAGE_PNG,
      "image/jpeg": ImageFormat.IMAGE_JPEG,
      "image/x-exr": ImageFormat.IMAGE_EXR,
    };
    const { bytes } = await this.viewer.still(formats[type]);
    return new Blob([bytes.slice()], { type });
  }

  // ---- inside

  private tell(name: keyof RelightViewerEvents, detail: unknown): void {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }

  // "https://host[:port]"; without it the origin of this module.
  private address(): string {
    const url = new URL(this.getAttribute("server") ?? import.meta.url, location.href);
    return `${url.protocol === "https:" || url.protocol === "wss:" ? "wss" : "ws"}://${url.host}/ws`;
  }

  private orbitOf(text: string | null): Orbit {
    const [azimuth = START.azimuth, elevation = START.elevation, zoom = 1] = (text ?? "")
      .split(/[\s,]+/)
      .filter(Boolean)
      .map(degrees)
      .map((x) => (Number.isFinite(x) ? x : 0));
    return clampOrbit({ ...START, azimuth, elevation, zoom: zoom || 1 });
  }

  private number(name: string, otherwise: number): number {
    const x = degrees(this.getAttribute(name) ?? "");
    return Number.isFinite(x) ? x : otherwise;
  }

  /** changed: the attribute that did; without it all are read. The light and the camera, which
   * hands turn as well, follow their own attributes alone, and the camera a new model. */
  private readAttributes(changed?: string): void {
    const word = (name: string) => this.getAttribute(name) ?? "";
    const anew = (name: string) => !changed || changed === name;
    const held = this.state.lamps[0] ?? FIRST_LAMP;
    const orbits = this.hasAttribute("camera-orbit") && (anew("camera-orbit") || anew("model"));
    const rgb = word("background").split(",").map(Number);
    const k = Math.max(0, this.number("intensity", 1));
    const lamp: LampState = {
      env: word("environment") || FIRST_LAMP.env,
      rotate: anew("rotate") ? this.number("rotate", 0) : held.rotate,
      tilt: anew("tilt") ? this.number("tilt", 0) : held.tilt,
      gain: [k, k, k],
    };
    const background = word("background");
    this.state = {
      model: word("model"),
      lamps: [lamp],
      material: word("material"),
      materials: {},
      variant: word("variant"),
      term: TERMS.find((one) => one === word("term")) ?? FIRST.term,
      exposure: this.number("exposure", 0),
      tone: TONES.find((one) => one === word("tone")) ?? FIRST.tone,
      background:
        background === "environment"
          ? background
          : rgb.length === 3 && rgb.every(Number.isFinite)
            ? (rgb as Vec3)
            : FIRST.background,
      orbit: orbits || !changed ? this.orbitOf(word("camera-orbit")) : this.state.orbit,
      compare: null,
    };
    const alt = word("alt") || word("model") || "3D model";
    this.stage.setAttribute("aria-label", alt);
    const poster = word("poster") || this.drawnPoster();
    if (poster && !this.shown && this.poster.src !== poster) {
      this.poster.src = poster;
      this.poster.onload = () => (this.poster.hidden = this.shown);
    }
  }

  // The daemon's picture of the model by plain HTTP, which is there before script has connected:
  // where the daemon has the light, and no token closes it. Empty: none.
  private drawnPoster(): string {
    const [lamp] = this.state.lamps;
    if (!this.state.model || !lamp || lamp.tilt || this.getAttribute("token")) return "";
    if (lamp.env.startsWith("page:")) return "";
    const url = new URL(
      `/v1/models/${encodeURIComponent(this.state.model)}/image.jpg`,
      this.address().replace(/^ws/, "http"),
    );
    const side = (x: number, otherwise: number) => Math.min(1600, Math.max(32, x || otherwise));
    const { background, exposure, tone, term, material, variant } = this.state;
    url.searchParams.set("env", lamp.env);
    url.searchParams.set("rotate", String(lamp.rotate));
    url.searchParams.set("gain", lamp.gain.join(","));
    url.searchParams.set(
      "size",
      `${side(this.clientWidth, 400)}x${side(this.clientHeight, 300)}`,
    );
    url.searchParams.set("exposure", String(exposure));
    url.searchParams.set("tone", tone);
    if (term !== "total") url.searchParams.set("term", term);
    if (material) url.searchParams.set("material", material);
    if (variant) url.searchParams.set("variant", variant);
    if (background !== "environment") url.searchParams.set("background", background.join(","));
    return url.href;
  }

  private async makeViewer(client: Client): Promise<void> {
    const { Stage } = await import("../scene/stage");
    let stage: InstanceType<typeof Stage> | null = null;
    try {
      stage = new Stage(this.canvas);
    } catch {
      stage = null; // the daemon draws pictures
    }
    if (this.client !== client) {
      stage?.dispose();
      return;
    }
    const viewer = new Viewer(
      client,
      { canvas: this.canvas, pictureCanvas: this.picture },
      stage,
      {
        status: (status) => this.statusChanged(status),
        info: (info) => (this.info = info),
        fault: (error, again) => this.fault(error, again),
        fine: () => (this.message.hidden = true),
      },
    );
    this.viewer = viewer;
    this.observer = new ResizeObserver(() => viewer.resized());
    this.observer.observe(this);
    viewer.resized();
    viewer.show(this.state);
    client.connect();
  }
  private info: ModelInfo | null = null;

  private connectionChanged(state: ConnectionState): void {
    if (state.is === "ready") {
      this.message.hidden = true;
      void this.viewer?.open();
    } else if (state.is === "refused") this.fault(state.error);
    else if (state.is === "offline" && state.why) this.fault(state.why, true);
    else if (state.is === "offline") this.say("Offline; it connects again by itself.");
  }

  private statusChanged(status: Status): void {
    this.bar.hidden = !status.progress;
    if (status.progress) this.bar.value = status.progress.fraction;
    if (!this.shown && status.frames > 0) {
      this.shown = true;
      this.poster.hidden = true;
      this.tell("load", { model: this.info?.model ?? "", name: this.info?.name ?? "" });
    }
    this.tell("status", status);
  }

  private say(text: string): void {
    this.message.textContent = text;
    this.message.hidden = false;
  }
  private fault(error: Error, again = false): void {
    const { title, text, remedy } = explain(error, again);
    this.say([title, text, remedy].filter(Boolean).join(". "));
    this.tell("error", { title, text, remedy });
  }

  // A hand turns the camera, which then turns by itself no longer.
  private turnBy(orbit: Orbit): void {
    cancelAnimationFrame(this.turning);
    this.cameraOrbit = orbit;
  }

  // A drag turns the light in place of the camera: as far as it would turn that one.
  private dragLight(orbit: Orbit): void {
    const old = this.state.orbit;
    const turned = ((orbit.azimuth - old.azimuth + 540) % 360) - 180;
    if (orbit.zoom !== old.zoom) this.cameraOrbit = { ...old, zoom: orbit.zoom };
    else this.turnLight(-turned, orbit.elevation - old.elevation);
  }

  private turn(): void {
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) return;
    let last = performance.now();
    const step = (now: number) => {
      const { orbit } = this.state;
      this.cameraOrbit = { ...orbit, azimuth: orbit.azimuth + (now - last) * 0.018 };
      last = now;
      this.turning = requestAnimationFrame(step);
    };
    this.turning = requestAnimationFrame(step);
  }
}

declare global {
  interface HTMLElementTagNameMap {
    "relight-viewer": RelightViewerElement;
  }
}
if (!customElements.get("relight-viewer"))
  customElements.define("relight-viewer", RelightViewerElement);
