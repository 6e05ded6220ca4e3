// SPDX-License-Identifier: MIT
// A VIEW of the daemon: the newest state goes out when the frame of the one before has come, so
// that a hand that is faster than the link costs no queue.
import {
  ViewAckSchema,
  ViewFrameSchema,
  ViewOpenRequestSchema,
  ViewSetAnswerSchema,
  ViewSetRequestSchema,
  ViewCloseRequestSchema,
  ViewCloseAnswerSchema,
  type ViewFrame,
} from "../gen/relight_pb";
import type { MessageInitShape } from "@bufbuild/protobuf";
import type { ViewStateSchema } from "../gen/relight_pb";
import type { Client } from "../protocol/client";
import { RelightError } from "../protocol/errors";
import { Type } from "../protocol/frame";

export type ViewInit = MessageInitShape<typeof ViewStateSchema>;
/** A change: fields of ViewState by name, their values, and texels of inline lights. */
export interface ViewChange {
  state: ViewInit;
  fields: string[];
  payload?: Uint8Array;
}
export interface ViewEvents {
  frame: (frame: ViewFrame, payload: Uint8Array, latencyMs: number) => void;
  error: (error: Error) => void;
}

const GIVE_UP_MS = 1500; // a state whose frame does not come does not block the next for longer

export class LightView {
  private readonly client: Client;
  private readonly events: ViewEvents;
  private readonly id: bigint;
  private sequence = 0n;
  private sentAt = 0;
  private waits = true;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private next: (() => Promise<ViewChange>) | null = null;
  private closed = false;

  constructor(
    client: Client,
    model: string,
    colors: boolean,
    first: ViewInit,
    payload: Uint8Array,
    events: ViewEvents,
  ) {
    this.client = client;
    this.events = events;
    this.sentAt = performance.now();
    this.id = client.stream(
      Type.ViewOpen,
      ViewOpenRequestSchema,
      { model, colors, state: first },
      ViewFrameSchema,
      (answer) => this.received(answer.message, answer.payload),
      (error) => {
        if (error && !this.closed) events.error(error);
      },
      payload,
    );
    this.watch();
  }

  private watch(): void {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      this.waits = false;
      this.send();
    }, GIVE_UP_MS);
  }

  /** Replaces the change that waits. It is made when it is sent: `make` says what differs then. */
  set(make: () => Promise<ViewChange>): void {
    this.next = make;
    if (!this.waits) this.send();
  }

  /** Whether no frame is awaited and no change waits. */
  get idle(): boolean {
    return !this.waits && !this.next;
  }

  private send(): void {
    const make = this.next;
    if (!make || this.closed) return;
    this.next = null;
    this.waits = true;
    this.watch();
    make()
      .then((change) => {
        this.sentAt = performance.now();
        this.sequence++;
        return this.client.request(
          Type.ViewSet,
          ViewSetRequestSchema,
          {
            view: this.id,
            sequence: this.sequence,
            state: { ...change.state, fields: change.fields },
          },
          ViewSetAnswerSchema,
          change.payload,
        );
      })
      .catch((error: unknown) => {
        this.waits = false;
        if (!this.closed) this.events.error(error as Error);
        this.send();
      });
  }

  private received(frame: ViewFrame, payload: Uint8Array): void {
    if (this.closed || (!frame.colors && !frame.image && !frame.error && !frame.equal)) return;
    this.client.notify(Type.ViewAck, ViewAckSchema, { view: this.id, shown: frame.frame });
    if (frame.error) this.events.error(new RelightError(frame.error));
    else this.events.frame(frame, payload, performance.now() - this.sentAt);
    if (frame.sequence < this.sequence) return;
    clearTimeout(this.timer);
    this.waits = false;
    this.send();
  }

  close(): void {
    this.closed = true;
    clearTimeout(this.timer);
    this.client
      .request(Type.ViewClose, ViewCloseRequestSchema, { view: this.id }, ViewCloseAnswerSchema)
      .catch(() => undefined);
  }
}
