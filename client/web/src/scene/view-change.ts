// SPDX-License-Identifier: MIT
// The state that a view of the daemon is to show, and the VIEW_SET with only what differs from the last.
import type { MessageInitShape } from "@bufbuild/protobuf";
import {
  ColorFormat,
  ImageFormat,
  type PictureSchema,
  type ShadeSchema,
} from "../gen/relight_pb";
import type { Client } from "../protocol/client";
import { busyMs } from "../protocol/busy";
import { RelightError } from "../protocol/errors";
import { TONES, type SceneState } from "../state/scene-state";
import type { Placed, Vec3 } from "./camera";
import { lightMessages, onlyTurned } from "./lights";
import type { ViewChange, ViewInit } from "./light-view";

export const vec = (v: Vec3) => ({ x: v[0], y: v[1], z: v[2] });
export const same = (a: unknown, b: unknown) =>
  a === b || JSON.stringify(a) === JSON.stringify(b);

type Picture = MessageInitShape<typeof PictureSchema>;

/** Options of a view that change while it is open. */
export interface Options {
  colorFormat: ColorFormat;
  mostRank: number; // rows of coefficients; 0: all
  exits: boolean;
  coarse: boolean;
}
/** The state that a view is to show, with its picture and options. */
export interface Wanted {
  state: SceneState;
  picture: Picture | null; // null: colours
  options: Options;
}

/** Whether frames are coefficients, in either of their formats. */
export function isCoefficients(format: ColorFormat | undefined): boolean {
  return (
    format === ColorFormat.COLOR_COEFFICIENTS ||
    format === ColorFormat.COLOR_COEFFICIENTS_PACKED
  );
}

function termOf(state: SceneState): number {
  return { total: 0, irradiance: 1, multiple: 2, single: 3 }[state.term];
}

/** The term and the media of a state. */
export function shadeOf(state: SceneState): MessageInitShape<typeof ShadeSchema> {
  const materials = Object.entries(state.materials).map(([object, material]) => ({
    object,
    material,
  }));
  return {
    term: termOf(state),
    material: state.material,
    materials,
    variant: state.variant,
  };
}

/** The picture of a state from a camera; sizes in pixels. */
export function pictureOf(
  state: SceneState,
  placed: Placed,
  size: { width: number; height: number },
): Picture {
  return {
    ...size,
    camera: {
      eye: vec(placed.eye),
      target: vec(placed.target),
      up: vec(placed.up),
      fovyDeg: placed.fovyDeg,
    },
    format: ImageFormat.IMAGE_JPEG,
    quality: 88,
    tone: TONES.indexOf(state.tone),
    exposureEv: state.exposure,
    plainBackground: state.background !== "environment",
    background: state.background === "environment" ? undefined : vec(state.background),
  };
}

const FIELD_OF = {
  colorFormat: "options.color_format",
  mostRank: "options.most_rank",
  exits: "options.exits",
  coarse: "options.coarse",
} as const;

/** The state that was last sent to a view. */
export class Told {
  private lamps: SceneState["lamps"];
  private material: string;
  private materials: SceneState["materials"];
  private term: SceneState["term"] | null; // null: not known
  private options: Partial<Options>; // those that are known

  constructor({ state, options }: Wanted) {
    this.lamps = state.lamps;
    this.material = state.material;
    this.materials = state.materials;
    this.term = state.term;
    this.options = options;
  }

  get format(): ColorFormat | undefined {
    return this.options.colorFormat;
  }

  /** What differs from `wanted`, which the view is told from now on. `again`: it is to be asked
   * for once more, after the daemon refused this change. */
  async change(client: Client, wanted: Wanted, again: () => void): Promise<ViewChange> {
    const { state } = wanted;
    const fields: string[] = [];
    const out: ViewInit = {};
    const payload = await this.lights(client, state.lamps, out, fields);
    this.lamps = state.lamps;
    if (this.material !== state.material || !same(this.materials, state.materials))
      fields.push("shade.material", "shade.materials", "shade.term");
    else if (this.term !== state.term) fields.push("shade.term");
    this.material = state.material;
    this.materials = state.materials;
    this.term = state.term;
    if (wanted.picture) {
      out.picture = wanted.picture;
      fields.push("picture");
    } else this.choose(wanted.options, out, fields);
    if (!fields.length) fields.push("shade.term"); // as it is: the daemon answers with a frame
    if (fields.includes("shade.term")) out.shade = shadeOf(state);
    const refused = (error: unknown) => this.refused(error, fields, again);
    return { state: out, fields, refused, ...(payload ? { payload } : {}) };
  }

  // Lights that only turn are sent as angles and gains; texels of others are the payload.
  private async lights(
    client: Client,
    lamps: SceneState["lamps"],
    out: ViewInit,
    fields: string[],
  ): Promise<Uint8Array | null> {
    if (same(this.lamps, lamps)) return null;
    if (onlyTurned(this.lamps, lamps)) {
      out.lights = lamps.map((lamp) => ({ rotateDeg: lamp.rotate, gain: vec(lamp.gain) }));
      fields.push("lights.rotate_deg", "lights.gain");
      return null;
    }
    const made = await lightMessages(client, lamps);
    out.lights = made.lights;
    fields.push("lights");
    return made.payload;
  }

  private choose(options: Options, out: ViewInit, fields: string[]): void {
    const changed: Partial<Options> = {};
    for (const key of Object.keys(FIELD_OF) as (keyof Options)[])
      if (options[key] !== this.options[key]) {
        Object.assign(changed, { [key]: options[key] });
        fields.push(FIELD_OF[key]);
      }
    if (Object.keys(changed).length) out.options = changed;
    this.options = options;
  }

  // The daemon applies all of a VIEW_SET or nothing, and later ones may be on their way: what the view
  // has is unknown. The next VIEW_SET has every field but the material that was refused.
  private refused(error: unknown, fields: string[], again: () => void): void {
    if (!(error instanceof RelightError)) return;
    this.lamps = [];
    this.term = null;
    this.options = {};
    if (fields.includes("shade.material") && busyMs(error) === null) again();
  }
}
