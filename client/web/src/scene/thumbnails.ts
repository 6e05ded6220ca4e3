// SPDX-License-Identifier: MIT
// Small pictures: a mirror ball under an environment, and a model under soft boxes.
import {
  ImageAnswerSchema,
  ImageFormat,
  ImageRequestSchema,
  Priority,
} from "../gen/relight_pb";
import { whenFree } from "../protocol/busy";
import type { Client } from "../protocol/client";
import { Type } from "../protocol/frame";
import { FIRST_LAMP } from "../state/scene-state";
import { bordered, faceOf } from "./environment";
import { environmentCube, lightMessages } from "./lights";

const SIDE = 88;
const encoded = (x: number) => {
  const y = (x * (x + 0.06)) / (x * (x + 0.62) + 0.09);
  return 255 * Math.min(1, Math.max(0, y)) ** (1 / 2.2);
};
const balls = new Map<string, Promise<ImageData>>();

/** A mirror ball, as it is seen from +z. */
export function thumbnail(client: Client, env: string): Promise<ImageData> {
  let ball = balls.get(env);
  if (!ball) {
    ball = draw(client, env);
    balls.set(env, ball);
    ball.catch(() => balls.delete(env));
  }
  return ball;
}

async function draw(client: Client, env: string): Promise<ImageData> {
  const cube = await environmentCube(client, env, 32);
  const { n } = cube;
  const m = n + 2;
  const edge = bordered(cube);
  const out = new ImageData(SIDE, SIDE);
  for (let i = 0; i < SIDE * SIDE; i++) {
    const x = (2 * ((i % SIDE) + 0.5)) / SIDE - 1;
    const y = 1 - (2 * (Math.floor(i / SIDE) + 0.5)) / SIDE;
    const r2 = x * x + y * y;
    const z = Math.sqrt(Math.max(0, 1 - r2));
    // The mirror direction of a ray along -z at normal (x, y, z).
    const [face, s, t] = faceOf(2 * z * x, 2 * z * y, 2 * z * z - 1);
    const px = Math.min(n - 1, Math.floor((s * 0.5 + 0.5) * n)) + 1;
    const py = Math.min(n - 1, Math.floor((t * 0.5 + 0.5) * n)) + 1;
    for (let c = 0; c < 3; c++)
      out.data[4 * i + c] = encoded(edge[((face * m + py) * m + px) * 4 + c] ?? 0);
    out.data[4 * i + 3] = 255 * Math.min(1, Math.max(0, (1 - Math.sqrt(r2)) * SIDE * 0.5));
  }
  return out;
}

/** A small JPEG of a model as a data URL. */
export async function modelPicture(client: Client, model: string): Promise<string> {
  const { lights, payload } = await lightMessages(client, [{ ...FIRST_LAMP, rotate: 20 }]);
  const ask = () =>
    client.request(
      Type.Image,
      ImageRequestSchema,
      {
        model,
        lights,
        priority: Priority.BULK,
        picture: {
          width: 192,
          height: 144,
          format: ImageFormat.IMAGE_JPEG,
          quality: 85,
          plainBackground: true,
          background: { x: 0.018, y: 0.019, z: 0.022 },
        },
      },
      ImageAnswerSchema,
      payload,
    );
  const answer = await whenFree(ask);
  return new Promise((resolve, reject) => {
    const reader = new FileReader();
    reader.onload = () => resolve(String(reader.result));
    reader.onerror = () => reject(new Error("the picture could not be read"));
    reader.readAsDataURL(new Blob([answer.payload.slice()], { type: "image/jpeg" }));
  });
}
