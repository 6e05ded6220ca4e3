// SPDX-License-Identifier: MIT
// Copies a link. A browser has no clipboard on plain http: there the old command copies, and where
// the browser refuses that too the link is shown, so that a person can copy it.
import { signal } from "@preact/signals";

/** The link that could not be copied; empty: none. */
export const linkToCopy = signal("");

function copiedByCommand(text: string): boolean {
  const focused = document.activeElement as HTMLElement | null;
  const field = document.createElement("textarea");
  field.value = text;
  field.readOnly = true;
  field.style.position = "fixed"; // it does not scroll the page
  document.body.append(field);
  field.select();
  try {
    return document.execCommand("copy");
  } catch {
    return false;
  } finally {
    field.remove();
    focused?.focus();
  }
}

/** Whether the text is in the clipboard now. */
export async function copied(text: string): Promise<boolean> {
  const clipboard = navigator.clipboard as Clipboard | undefined;
  try {
    if (clipboard) {
      await clipboard.writeText(text);
      return true;
    }
  } catch {
    // not permitted: the command may be
  }
  return copiedByCommand(text);
}

/** Copies a link, or shows it where it cannot be copied. */
export async function copyLink(url: string): Promise<boolean> {
  const done = await copied(url);
  linkToCopy.value = done ? "" : url;
  return done;
}
