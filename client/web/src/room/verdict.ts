// SPDX-License-Identifier: MIT
// What has changed since a decision: the scene, or the model under it. A bake replaces its preview
// under the same id, so that equal scenes may show another bake.
import type { Decision, ModelInfo, Seen } from "../gen/relight_pb";

/** The room's model as the daemon has it now. */
export type Made = Pick<ModelInfo, "model" | "meshHash" | "bakeHash">;
/** Missing: it is not known. */
type MadeNow = Made | null;

/** What happened to the model since it was seen; empty: nothing, or it is not known. */
export function modelChange(seen: Seen | undefined, made: MadeNow): string {
  if (!seen || seen.model !== made?.model || !seen.meshHash || !made.meshHash) return "";
  if (seen.meshHash !== made.meshHash) return "the model has another shape since";
  if (seen.bakeHash === made.bakeHash) return "";
  if (!seen.bakeHash) return "the model was baked since";
  return made.bakeHash ? "the model was baked anew since" : "the model has no bake now";
}

/** Whether the room still shows the revision, mesh and bake that the decision was made about. now: the number of
 * its revision. */
export const stands = (decision: Decision, now: number, made: MadeNow) =>
  (decision.seen?.revision ?? 0) === now && !modelChange(decision.seen, made);

export function verdict(decision: Decision, now: number, made: MadeNow): string {
  const at = decision.seen?.revision ?? 0;
  const word = decision.approve ? "approved" : "rejected";
  if (stands(decision, now, made)) return `${word} as it is now`;
  const change = modelChange(decision.seen, made);
  const scene = at === now ? "" : now ? `, now at ${now}` : ", changed since";
  return `${word} at revision ${at}${scene}${change && `; ${change}`}`;
}
