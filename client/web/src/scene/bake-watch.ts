// SPDX-License-Identifier: MIT
// Follows the bake of the model that is shown, one at a time.
import {
  CancelJobAnswerSchema,
  CancelJobRequestSchema,
  JobState,
  ModelState,
  ProgressSchema,
  WatchRequestSchema,
  type ModelInfo,
  type Progress,
} from "../gen/relight_pb";
import { busyMs } from "../protocol/busy";
import type { Client } from "../protocol/client";
import { Type } from "../protocol/frame";

const PAUSE_MS = 1000; // before a model is opened again whose bake could not be followed

const bakes = ({ state }: ModelInfo) =>
  state === ModelState.MODEL_BAKING || state === ModelState.MODEL_RECEIVED;

export interface BakeEvents {
  /** How far the bake is; null: none is under way. */
  progress: (progress: Progress | null) => void;
  ended: () => void;
}

export class BakeWatch {
  private readonly client: Client;
  private readonly events: BakeEvents;
  private request = 0n; // 0: nothing is followed
  private model = "";
  private pause: ReturnType<typeof setTimeout> | undefined;

  constructor(client: Client, events: BakeEvents) {
    this.client = client;
    this.events = events;
  }

  /** Follows the bake of a model, if it has one, and no longer that of another. */
  follow(info: ModelInfo): void {
    if (this.request && this.model !== info.model) {
      this.close();
      this.events.progress(null);
    }
    if (this.request || !bakes(info)) return;
    this.model = info.model;
    let over = false; // the bake is
    const mine = (this.request = this.client.stream(
      Type.Watch,
      WatchRequestSchema,
      { job: info.model },
      ProgressSchema,
      ({ message }) => {
        const ended = message.state >= JobState.JOB_DONE;
        over = ended && message.state !== JobState.JOB_NONE;
        if (this.request === mine) this.events.progress(ended ? null : message);
      },
      (error) => {
        if (this.request !== mine) return;
        if (over || !this.client.hello) this.end();
        else this.pause = setTimeout(() => this.end(), busyMs(error) ?? PAUSE_MS);
      },
    ));
  }

  private end(): void {
    this.request = 0n;
    if (this.client.hello) this.events.ended();
    else this.events.progress(null); // it may end before the connection is back
  }

  async cancel(job: string): Promise<void> {
    await this.client.request(
      Type.CancelJob,
      CancelJobRequestSchema,
      { job },
      CancelJobAnswerSchema,
    );
  }

  close(): void {
    clearTimeout(this.pause);
    if (this.request) this.client.cancel(this.request);
    this.request = 0n;
  }
}
