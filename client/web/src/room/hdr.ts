// SPDX-License-Identifier: MIT
// An environment of the page as a Radiance file, so that a room's daemon has it.
import { BUILTIN_LIGHTS } from "../scene/builtin-lights";
import type { Vec3 } from "../scene/camera";

const WIDTH = 256;
const HEIGHT = 128;

/** Shared exponent: three mantissas of 8 bits, and the exponent plus 128. */
export function rgbe(rgb: readonly number[]): [number, number, number, number] {
  const most = Math.max(...rgb);
  if (!(most > 1e-32)) return [0, 0, 0, 0];
  const exponent = Math.floor(Math.log2(most)) + 1;
  const scale = 256 / 2 ** exponent;
  const [r = 0, g = 0, b = 0] = rgb.map((x) => Math.min(255, Math.floor(x * scale)));
  return [r, g, b, exponent + 128];
}

/** Latitude and longitude, top row first; the middle column looks along -z, as PROTOCOL.md has it. */
function direction(x: number, y: number): Vec3 {
  const around = (2 * Math.PI * (x + 0.5)) / WIDTH;
  const down = (Math.PI * (y + 0.5)) / HEIGHT;
  return [
    -Math.sin(down) * Math.sin(around),
    Math.cos(down),
    Math.sin(down) * Math.cos(around),
  ];
}

/** The file of "page:ID"; null: there is no such light. */
export function builtinFile(env: string): Uint8Array | null {
  const light = BUILTIN_LIGHTS.find((one) => `page:${one.id}` === env);
  if (!light) return null;
  const head = new TextEncoder().encode(
    `#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y ${HEIGHT} +X ${WIDTH}\n`,
  );
  const out = new Uint8Array(head.length + 4 * WIDTH * HEIGHT);
  out.set(head);
  for (let y = 0; y < HEIGHT; y++)
    for (let x = 0; x < WIDTH; x++)
      out.set(rgbe(light.radiance(direction(x, y))), head.length + 4 * (y * WIDTH + x));
  return out;
}
