// SPDX-License-Identifier: MIT
// Lights of a scene: as cube maps for the browser, as Light messages for the daemon.
import { EnvAnswerSchema, EnvRequestSchema } from "../gen/relight_pb";
import { whenFree } from "../protocol/busy";
import type { Client } from "../protocol/client";
import { Type, words } from "../protocol/frame";
import type { LampState } from "../state/scene-state";
import { builtinCube, constantCube } from "./builtin-lights";
import { decodeRgb9e5, summed, type Cube, type Lamp } from "./environment";

/** Texels along a side of cubes that are sent with a request, and of those that are fetched. */
const SENT_SIDE = 32;
const FETCHED_SIDE = 128;
const KEPT = 12;

const fetched = new Map<string, Promise<Cube>>();

/** The cube of a lamp's environment; rejects where the daemon does not have it. */
export function environmentCube(
  client: Client,
  env: string,
  side = FETCHED_SIDE,
): Promise<Cube> {
  if (env.startsWith("page:")) {
    const cube = builtinCube(env, side === FETCHED_SIDE ? 64 : side);
    return cube
      ? Promise.resolve(cube)
      : Promise.reject(new Error(`no light is called ${env}`));
  }
  if (env.startsWith("constant")) return Promise.resolve(constantCube(env));
  const key = `${env}/${side}`;
  let cube = fetched.get(key);
  if (!cube) {
    const ask = () =>
      client.request(Type.Env, EnvRequestSchema, { env, cubeN: side }, EnvAnswerSchema);
    cube = whenFree(ask).then(({ message, payload }) => {
      const n = message.cubeN;
      if (!n) throw new Error("this daemon does not send environments (feature env-cube)");
      return { n, texel: decodeRgb9e5(words(payload, 0, 6 * n * n)) };
    });
    fetched.set(key, cube);
    cube.catch(() => fetched.delete(key));
    const oldest = fetched.keys().next().value;
    if (fetched.size > KEPT && oldest) fetched.delete(oldest);
  }
  return cube;
}

export async function lampsOf(client: Client, lamps: readonly LampState[]): Promise<Lamp[]> {
  return Promise.all(
    lamps.map(async (lamp) => ({
      cube: await environmentCube(client, lamp.env),
      rotateDeg: lamp.rotate,
      tiltDeg: lamp.tilt,
      gain: lamp.gain,
    })),
  );
}

/** The fields of a Light message. */
export interface LightInit {
  env: string;
  cubeN: number;
  rotateDeg: number;
  gain: { x: number; y: number; z: number };
}

/** Whether two lists differ in turn and gain only, which the daemon applies without new texels. */
export function onlyTurned(a: readonly LampState[], b: readonly LampState[]): boolean {
  return (
    a.length === b.length &&
    a.every((lamp, i) => lamp.env === b[i]?.env && lamp.tilt === b[i].tilt)
  );
}

/** Light messages, and the texels of those that the daemon cannot name: lights of the page, and
 * environments that are tilted. */
export async function lightMessages(
  client: Client,
  lamps: readonly LampState[],
): Promise<{ lights: LightInit[]; payload: Uint8Array }> {
  const parts: Float32Array[] = [];
  const lights: LightInit[] = [];
  for (const lamp of lamps) {
    const sent = lamp.env.startsWith("page:") || lamp.tilt !== 0;
    if (sent) {
      const cube = await environmentCube(client, lamp.env);
      const still: Lamp = { cube, rotateDeg: 0, tiltDeg: lamp.tilt, gain: [1, 1, 1] };
      parts.push(summed([still], SENT_SIDE).texel);
    }
    lights.push({
      env: sent ? "" : lamp.env,
      cubeN: sent ? SENT_SIDE : 0,
      rotateDeg: lamp.rotate,
      gain: { x: lamp.gain[0], y: lamp.gain[1], z: lamp.gain[2] },
    });
  }
  const all = new Float32Array(parts.reduce((n, part) => n + part.length, 0));
  let at = 0;
  for (const part of parts) {
    all.set(part, at);
    at += part.length;
  }
  return { lights, payload: new Uint8Array(all.buffer) };
}
