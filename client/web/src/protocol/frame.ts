// SPDX-License-Identifier: MIT
// Frames of PROTOCOL.md, section 1: 32 bytes, a header, and a payload at a multiple of 64.

export const FRAME_BYTES = 32;
export const FLAG_MORE = 1;
export const FLAG_LAST = 2;
export const ANSWER = 0x8000;

export enum Type {
  Hello = 1,
  Ping = 2,
  List = 3,
  PutBlob = 4,
  Env = 5,
  Load = 6,
  Watch = 7,
  CancelJob = 8,
  Cancel = 9,
  Info = 10,
  Geometry = 11,
  Colors = 12,
  Image = 13,
  ViewOpen = 14,
  ViewSet = 15,
  ViewClose = 16,
  Unload = 18,
  Stats = 19,
  Subscribe = 20,
  ViewAck = 24,
  GetBlob = 25,
  Factors = 27,
  RoomCreate = 28,
  RoomList = 29,
  RoomGet = 30,
  RoomEdit = 31,
  RoomPicture = 32,
  RoomPresence = 33,
  Goaway = 0xfffe,
  Error = 0xffff,
}

export interface Frame {
  type: number;
  flags: number;
  id: bigint;
  header: Uint8Array;
  payload: Uint8Array;
}

const MAGIC = 0x54474c52; // "RLGT", little-endian
const PAYLOAD_ALIGN = 64;

function payloadAt(headerBytes: number): number {
  return Math.ceil((FRAME_BYTES + headerBytes) / PAYLOAD_ALIGN) * PAYLOAD_ALIGN;
}

/** A request's bytes. deadlineMs 0: none. */
export function encodeFrame(
  type: number,
  id: bigint,
  header: Uint8Array,
  payload: Uint8Array = new Uint8Array(0),
  deadlineMs = 0,
): Uint8Array {
  const at = payload.length ? payloadAt(header.length) : FRAME_BYTES + header.length;
  const bytes = new Uint8Array(at + payload.length);
  const view = new DataView(bytes.buffer);
  view.setUint32(0, MAGIC, true);
  view.setUint8(4, 1);
  view.setUint8(5, FLAG_LAST);
  view.setUint16(6, type, true);
  view.setBigUint64(8, id, true);
  view.setUint32(16, header.length, true);
  view.setUint32(20, deadlineMs, true);
  view.setBigUint64(24, BigInt(payload.length), true);
  bytes.set(header, FRAME_BYTES);
  bytes.set(payload, at);
  return bytes;
}

/** The frame of one WebSocket message; the header and payload share its memory. Throws where the
 * message is no whole frame of version 1. */
export function decodeFrame(message: ArrayBuffer): Frame {
  if (message.byteLength < FRAME_BYTES) throw new Error("a frame has at least 32 bytes");
  const view = new DataView(message);
  if (view.getUint32(0, true) !== MAGIC || view.getUint8(4) !== 1)
    throw new Error("not a frame of protocol version 1");
  const flags = view.getUint8(5);
  if (flags & 0x0c) throw new Error("the frame has flags of a later version");
  const headerBytes = view.getUint32(16, true);
  const payloadBytes = Number(view.getBigUint64(24, true));
  const at = payloadBytes ? payloadAt(headerBytes) : FRAME_BYTES + headerBytes;
  if (at + payloadBytes !== message.byteLength)
    throw new Error("the lengths of a frame contradict its message");
  return {
    type: view.getUint16(6, true),
    flags,
    id: view.getBigUint64(8, true),
    header: new Uint8Array(message, FRAME_BYTES, headerBytes),
    payload: new Uint8Array(message, at, payloadBytes),
  };
}

/** A section of a payload as a typed array: in place where it is aligned, else a copy. */
export function floats(payload: Uint8Array, offset: number, n: number): Float32Array {
  return new Float32Array(...section(payload, offset, n, 4));
}
export function words(payload: Uint8Array, offset: number, n: number): Uint32Array {
  return new Uint32Array(...section(payload, offset, n, 4));
}
export function halves(payload: Uint8Array, offset: number, n: number): Uint16Array {
  return new Uint16Array(...section(payload, offset, n, 2));
}
export function shorts(payload: Uint8Array, offset: number, n: number): Int16Array {
  return new Int16Array(...section(payload, offset, n, 2));
}
export function bytes(payload: Uint8Array, offset: number, n: number): Int8Array {
  return new Int8Array(...section(payload, offset, n, 1));
}
function section(
  payload: Uint8Array,
  offset: number,
  n: number,
  size: number,
): [ArrayBufferLike, number, number] {
  if (offset + n * size > payload.length) throw new Error("a section ends behind its payload");
  const at = payload.byteOffset + offset;
  if (at % size === 0) return [payload.buffer, at, n];
  return [payload.slice(offset, offset + n * size).buffer, 0, n];
}
