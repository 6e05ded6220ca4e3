// SPDX-License-Identifier: MIT
// The client alone, as the package relight-viewer exports it: one connection, uploads, faults in
// words, sections of payloads, decoded colours, and every message of relight.proto.
export { Client, type Answer, type ConnectionState } from "./protocol/client";
export { DisconnectedError, explain, RelightError, type Notice } from "./protocol/errors";
export { floats, halves, shorts, Type, words } from "./protocol/frame";
export { upload } from "./protocol/upload";
export { decodeRgb9e5 } from "./scene/environment";
export * from "./gen/relight_pb";
