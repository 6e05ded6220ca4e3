// SPDX-License-Identifier: MIT
// The bake and the shape that the room's model has now: what decisions and pictures are about.
import { computed, effect, signal } from "@preact/signals";
import { InfoRequestSchema, ModelInfoSchema } from "../gen/relight_pb";
import { whenFree } from "../protocol/busy";
import { Type } from "../protocol/frame";
import { client, connection, info, models } from "../ui/store";
import { state } from "./here";
import type { Made } from "./verdict";

/** Null: it is not known, because the model is gone or cannot be read yet. */
export const made = signal<Made | null>(null);
/** Equal as long as nothing about the model changes. */
export const madeKey = computed(() => {
  const { model = "", meshHash = "", bakeHash = "" } = made.value ?? {};
  return `${model} ${meshHash} ${bakeHash}`;
});

const wanted = computed(() => state.value?.scene?.model ?? "");
let turn = 0;

async function ask(model: string): Promise<void> {
  const mine = ++turn;
  const answer = model
    ? await whenFree(
        () => client.request(Type.Info, InfoRequestSchema, { model }, ModelInfoSchema),
        () => mine === turn,
      )
        .then(({ message }) => message)
        .catch(() => null)
    : null;
  if (mine === turn) made.value = answer;
}

/** Asks the daemon again. */
export const lookAgain = () => ask(wanted.value);

// The end of a bake changes the list of models, and what the viewer knows of its own.
effect(() => {
  void [info.value, models.value];
  if (connection.value.is === "ready") void ask(wanted.value);
});
