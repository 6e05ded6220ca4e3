// SPDX-License-Identifier: MIT
// Faults of the daemon and of the connection, in words with what to do.
import { ErrorCode, type Error as ErrorMessage } from "../gen/relight_pb";

export class RelightError extends Error {
  readonly code: ErrorCode;
  readonly hint: string;
  readonly retryAfterMs: number;
  constructor(message: Pick<ErrorMessage, "code" | "text" | "hint" | "retryAfterMs">) {
    super(message.text || "the daemon gave no reason");
    this.name = "RelightError";
    this.code = message.code;
    this.hint = message.hint;
    this.retryAfterMs = message.retryAfterMs;
  }
}

/** The connection ended before the answer. */
export class DisconnectedError extends Error {
  constructor() {
    super("the connection to the daemon was lost");
    this.name = "DisconnectedError";
  }
}

/** What the page itself refuses or misses: its text says all, or the remedy does. */
export class PageError extends Error {
  readonly remedy: string;
  constructor(text: string, remedy = "") {
    super(text);
    this.name = "PageError";
    this.remedy = remedy;
  }
}

export interface Notice {
  kind: "offline" | "busy" | "forbidden" | "memory" | "fault";
  title: string;
  text: string;
  remedy: string;
}

const byCode: Partial<Record<ErrorCode, [Notice["kind"], string, string]>> = {
  [ErrorCode.ERROR_FORBIDDEN]: [
    "forbidden",
    "Not permitted",
    "Ask who runs the daemon for a token with the scope that is named here.",
  ],
  [ErrorCode.ERROR_NO_MEMORY]: [
    "memory",
    "The daemon is out of memory",
    "Unload models that nobody uses, or give the daemon more memory (--memory, --cache).",
  ],
  [ErrorCode.ERROR_LIMIT]: [
    "memory",
    "Larger than the daemon allows",
    "Use a smaller file, or raise the limit that is named here.",
  ],
  [ErrorCode.ERROR_NOT_FOUND]: [
    "fault",
    "Not there",
    "Choose another one; it may have been deleted.",
  ],
  [ErrorCode.ERROR_OUT_OF_RANGE]: ["fault", "Out of range", "Choose a value inside the range."],
  [ErrorCode.ERROR_FORMAT]: [
    "fault",
    "The file could not be read",
    "Models: .glb .gltf .obj .ply .stl; light: .hdr .exr .png .jpg.",
  ],
};

// The daemon's own hint is for programs.
function explainBusy(error: RelightError, again: boolean): Notice {
  const seconds = Math.max(1, Math.ceil(error.retryAfterMs / 1000));
  return {
    kind: "busy",
    title: "The daemon is busy",
    text: error.message,
    remedy: again ? "It is tried again by itself." : `Try it again in ${seconds} s.`,
  };
}

/** The fault in words for people: what happened, and what they can do. again: the request is repeated
 * by itself. */
export function explain(error: unknown, again = false): Notice {
  if (error instanceof RelightError) {
    if (error.code === ErrorCode.ERROR_BUSY) return explainBusy(error, again);
    const [kind, title, remedy] = byCode[error.code] ?? ["fault", "That did not work", ""];
    return { kind, title, text: error.message, remedy: error.hint || remedy };
  }
  if (error instanceof DisconnectedError)
    return {
      kind: "offline",
      title: "Offline",
      text: error.message,
      remedy: "The page connects again by itself; nothing is lost.",
    };
  const text = error instanceof Error ? error.message : String(error);
  if (error instanceof PageError)
    return { kind: "fault", title: "That did not work", text, remedy: error.remedy };
  return { kind: "fault", title: "That did not work", text, remedy: "Reload the page." };
}
