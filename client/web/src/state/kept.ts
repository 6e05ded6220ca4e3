// SPDX-License-Identifier: MIT
// What the browser keeps for the page. It may refuse: where cookies are blocked, or the disk is full.
// The page goes on without it then.
type Storage = "localStorage" | "sessionStorage";

/** null: nothing is kept. */
export function kept(where: Storage, key: string): string | null {
  try {
    return globalThis[where].getItem(key);
  } catch {
    return null;
  }
}

/** text: null: it is kept no longer. */
export function keep(where: Storage, key: string, text: string | null): void {
  try {
    if (text === null) globalThis[where].removeItem(key);
    else globalThis[where].setItem(key, text);
  } catch {
    // not kept
  }
}
