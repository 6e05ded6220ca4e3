// SPDX-License-Identifier: MIT
// Uploads by content (PUT_BLOB), and LOAD of a model that was uploaded.
import { PutBlobAnswerSchema, PutBlobRequestSchema } from "../gen/relight_pb";
import type { Client } from "./client";
import { PageError } from "./errors";
import { Type } from "./frame";

const CHUNK = 1 << 20;

function hex(bytes: Uint8Array): string {
  return Array.from(bytes, (b) => b.toString(16).padStart(2, "0")).join("");
}

/** Sends a file and returns its hash. Where the browser can hash (a secure context) a file that
 * the daemon has is not sent again. `progress` gets the share that was sent, in [0, 1]. */
export async function upload(
  client: Client,
  name: string,
  bytes: Uint8Array,
  progress: (share: number) => void = () => undefined,
  aborted: () => boolean = () => false,
): Promise<string> {
  const size = BigInt(bytes.length);
  const subtle = globalThis.crypto.subtle as SubtleCrypto | undefined;
  const hash = subtle
    ? hex(new Uint8Array(await subtle.digest("SHA-256", bytes as Uint8Array<ArrayBuffer>)))
    : "";
  const handle = hash ? "" : hex(globalThis.crypto.getRandomValues(new Uint8Array(32)));
  const put = (offset: number, chunk?: Uint8Array) =>
    client.request(
      Type.PutBlob,
      PutBlobRequestSchema,
      { hash, upload: handle, size, offset: BigInt(offset), name },
      PutBlobAnswerSchema,
      chunk,
    );
  let at = 0;
  if (hash) {
    const { message } = await put(0);
    if (message.complete) return hash;
    at = Number(message.received);
  }
  const step = Math.min(client.hello?.chunk || CHUNK, CHUNK);
  while (at < bytes.length) {
    if (aborted()) throw new DOMException("the upload was cancelled", "AbortError");
    const { message } = await put(at, bytes.subarray(at, at + step));
    if (message.complete) {
      progress(1);
      return message.hash || hash;
    }
    at = Number(message.received);
    progress(at / bytes.length);
  }
  throw new PageError("The daemon did not confirm the upload.", "Try it again.");
}
