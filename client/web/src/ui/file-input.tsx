// SPDX-License-Identifier: MIT
// The choice of files from the person's machine.
import { takeFiles } from "./store";

/** The files that were chosen. The input is empty then, so that the same file can be chosen again:
 * its list of files is emptied with its value. */
export function takeChosen(input: { files: Iterable<File> | null; value: string }): File[] {
  const chosen = [...(input.files ?? [])];
  input.value = "";
  return chosen;
}

/** accept: as the attribute. chosen: called before the files are taken. */
export function FileInput(props: { accept: string; chosen?: () => void }) {
  return (
    <input
      type="file"
      class="hidden-input"
      accept={props.accept}
      onChange={(event) => {
        const files = takeChosen(event.currentTarget);
        props.chosen?.();
        void takeFiles(files);
      }}
    />
  );
}
