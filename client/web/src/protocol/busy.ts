// SPDX-License-Identifier: MIT
// Requests that the daemon refuses because it is busy are repeated when it says.
import { ErrorCode } from "../gen/relight_pb";
import { RelightError } from "./errors";

const LEAST_MS = 250; // also where the daemon names no time
const MOST_MS = 30_000;

/** After how long a request is repeated [ms]; null: waiting does not help. */
export function busyMs(error: unknown): number | null {
  if (!(error instanceof RelightError) || error.code !== ErrorCode.ERROR_BUSY) return null;
  return Math.min(MOST_MS, Math.max(LEAST_MS, error.retryAfterMs));
}

/** Asks until the daemon is not busy. `refused` hears of each refusal, and says whether the answer is
 * still wanted; where it is not the refusal is thrown. */
export async function whenFree<T>(
  ask: () => Promise<T>,
  refused: (error: unknown) => boolean = () => true,
): Promise<T> {
  for (;;) {
    try {
      return await ask();
    } catch (error) {
      const wait = busyMs(error);
      if (wait === null || !refused(error)) throw error;
      await new Promise((done) => setTimeout(done, wait));
    }
  }
}
