// SPDX-License-Identifier: MIT
// Frames against the byte-exact vectors of proto/, and faults in words.
import { fromBinary } from "@bufbuild/protobuf";
import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { describe, expect, test } from "vitest";
import { ErrorCode, HelloRequestSchema } from "../src/gen/relight_pb";
import { DisconnectedError, explain, PageError, RelightError } from "../src/protocol/errors";
import { decodeFrame, encodeFrame, floats, Type } from "../src/protocol/frame";

const vector = (name: string) => {
  const bytes = readFileSync(
    fileURLToPath(new URL(`../../../proto/vectors/${name}`, import.meta.url)),
  );
  return bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length) as ArrayBuffer;
};

describe("frames", () => {
  test("HELLO of the vectors is read and written byte for byte", () => {
    const bytes = vector("hello_request.bin");
    const frame = decodeFrame(bytes);
    expect(frame.type).toBe(Type.Hello);
    expect(fromBinary(HelloRequestSchema, frame.header).versionMin).toBe(1);
    const again = encodeFrame(frame.type, frame.id, frame.header, frame.payload);
    expect([...again]).toEqual([...new Uint8Array(bytes)]);
  });
  test("a payload lies at a multiple of 64, and its sections are checked", () => {
    const payload = new Uint8Array(new Float32Array([1, 2, 3]).buffer);
    const bytes = encodeFrame(Type.Colors, 7n, new Uint8Array(5), payload);
    expect(bytes.length).toBe(64 + 12);
    const frame = decodeFrame(bytes.buffer as ArrayBuffer);
    expect([...floats(frame.payload, 0, 3)]).toEqual([1, 2, 3]);
    expect(() => floats(frame.payload, 4, 3)).toThrow();
  });
  test("broken frames are refused", () => {
    const bytes = encodeFrame(Type.Ping, 1n, new Uint8Array(0));
    const broken = (at: number, value: number) => {
      const copy = bytes.slice();
      copy[at] = value;
      return copy.buffer;
    };
    expect(() => decodeFrame(broken(0, 0))).toThrow();
    expect(() => decodeFrame(broken(4, 2))).toThrow();
    expect(() => decodeFrame(broken(5, 4))).toThrow();
    expect(() => decodeFrame(broken(16, 9))).toThrow();
    expect(() => decodeFrame(bytes.slice(0, 31).buffer)).toThrow();
  });
});

describe("faults in words", () => {
  test("each says what to do, and the daemon's own hint goes first", () => {
    const error = (code: ErrorCode, hint: string) =>
      explain(new RelightError({ code, text: "why", hint, retryAfterMs: 0 }));
    expect(error(ErrorCode.ERROR_BUSY, "").kind).toBe("busy");
    expect(error(ErrorCode.ERROR_NO_MEMORY, "").kind).toBe("memory");
    expect(error(ErrorCode.ERROR_FORBIDDEN, "").kind).toBe("forbidden");
    expect(error(ErrorCode.ERROR_FORBIDDEN, "ask Anna").remedy).toBe("ask Anna");
    expect(explain(new DisconnectedError()).kind).toBe("offline");
    for (const code of [ErrorCode.ERROR_BUSY, ErrorCode.ERROR_LIMIT, ErrorCode.ERROR_NOT_FOUND])
      expect(error(code, "").remedy).not.toBe("");
  });

  test("a fault that a person can mend is none that reloading mends", () => {
    const said = explain(new PageError("The light is not here", "Choose another one."));
    expect(said).toMatchObject({
      text: "The light is not here",
      remedy: "Choose another one.",
    });
    expect(explain(new PageError("That is no model")).remedy).toBe("");
    expect(explain(new TypeError("x is undefined")).remedy).toBe("Reload the page.");
  });
});
