// SPDX-License-Identifier: MIT
// Pictures that the daemon draws of scenes that a room keeps: the same bytes whenever they are
// drawn again by the same build.
import { ImageAnswerSchema, RoomPictureRequestSchema, type Drawn } from "../gen/relight_pb";
import { difference, type Difference } from "../scene/color-difference";
import { whenFree } from "../protocol/busy";
import { Type } from "../protocol/frame";
import { client } from "../ui/store";
import { roomId, state } from "./here";
import { madeKey } from "./made";

/** One of them; none: the room's scene as it is. */
export interface Kept {
  pin?: bigint;
  decision?: bigint;
  revision?: number;
}
export interface Size {
  width: number;
  height: number;
}
const SMALL = { width: 480, height: 360 };
const MOST = 60; // pictures that are kept here

/** A PNG file and the hashes of the model that it shows; older daemons send no hashes. */
export interface Drawing {
  png: Uint8Array;
  drawn: Drawn | undefined;
}
const pictures = new Map<string, Promise<Drawing>>();

function ask(what: Kept, size: Size): Promise<Drawing> {
  const room = roomId.value;
  const request = () =>
    client.request(
      Type.RoomPicture,
      RoomPictureRequestSchema,
      { room, ...what, ...size },
      ImageAnswerSchema,
    );
  return whenFree(request, () => roomId.value === room).then(({ message, payload }) => ({
    png: payload,
    drawn: message.drawn,
  }));
}
/** Equal as long as the room's scene as it is gives the same picture. */
export const presentKey = () => `${String(state.value?.sequence ?? "")} ${madeKey.value}`;
const NOW = "now ";
/** Pictures of the room's scene as it is are asked for again. */
export function forgetPresent(): void {
  for (const key of pictures.keys()) if (key.includes(`/${NOW}`)) pictures.delete(key);
}
export function drawingOf(what: Kept, size: Size = SMALL): Promise<Drawing> {
  const isNow = !what.pin && !what.decision && !what.revision;
  const { pin = "", decision = "", revision = "" } = what;
  const key = [
    roomId.value,
    isNow ? `${NOW}${presentKey()}` : "",
    ...[pin, decision, revision].map(String),
    size.width,
    size.height,
  ].join("/");
  const known = pictures.get(key);
  if (known) return known;
  const made = ask(what, size);
  pictures.set(key, made);
  made.catch(() => pictures.delete(key));
  const [oldest] = pictures.keys();
  if (pictures.size > MOST && oldest !== undefined) pictures.delete(oldest);
  return made;
}

// The page's content security policy has no blob: for images.
function dataUrl(png: Uint8Array): Promise<string> {
  return new Promise((resolve, reject) => {
    const reader = new FileReader();
    reader.onload = () => resolve(String(reader.result));
    reader.onerror = () => reject(reader.error ?? new Error("the picture cannot be shown"));
    reader.readAsDataURL(new Blob([png.slice()], { type: "image/png" }));
  });
}
/** A data: address. */
export async function pictureOf(what: Kept, size?: Size): Promise<string> {
  return dataUrl((await drawingOf(what, size)).png);
}

/** SHA-256 in hex; empty where the browser cannot hash (no secure context). */
export async function hashOf(bytes: Uint8Array): Promise<string> {
  const subtle = globalThis.crypto.subtle as SubtleCrypto | undefined;
  if (!subtle) return "";
  const hash = await subtle.digest("SHA-256", bytes as Uint8Array<ArrayBuffer>);
  return Array.from(new Uint8Array(hash), (b) => b.toString(16).padStart(2, "0")).join("");
}

async function pixelsOf(what: Kept, size: Size): Promise<ImageData> {
  const { png } = await drawingOf(what, size);
  const bitmap = await createImageBitmap(new Blob([png.slice()], { type: "image/png" }));
  const canvas = document.createElement("canvas");
  canvas.width = bitmap.width;
  canvas.height = bitmap.height;
  const context = canvas.getContext("2d");
  if (!context) throw new Error("the browser has no canvas for the comparison");
  context.drawImage(bitmap, 0, 0);
  return context.getImageData(0, 0, bitmap.width, bitmap.height);
}

export type Compared = Difference & Size;
/** ΔE₀₀ of two scenes, pixel by pixel. The numbers are about pixels that are not plain background
 * in both: where the two are the same as the picture's first corner, they do not count. */
export async function compared(a: Kept, b: Kept, size: Size): Promise<Compared> {
  const [one, two] = await Promise.all([pixelsOf(a, size), pixelsOf(b, size)]);
  const model = (i: number) =>
    [0, 1, 2].some(
      (c) => one.data[4 * i + c] !== one.data[c] || two.data[4 * i + c] !== two.data[c],
    );
  return {
    ...difference(one.data, two.data, model),
    width: one.width,
    height: one.height,
  };
}
