// SPDX-License-Identifier: MIT
// A VIEW of the daemon: the newest state goes out when the frame of one before has come, so that a
// hand that is faster than the link costs no queue. On a long link several states are outstanding,
// on a thin one the frames of a moving hand are coarse, and the state that rests is asked for again
// in full.
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
import { LEVELS, Pace } from "./pace";

export type ViewInit = MessageInitShape<typeof ViewStateSchema>;
/** A change: fields of ViewState by name, their values, and texels of inline lights. */
export interface ViewChange {
  state: ViewInit;
  fields: string[];
  payload?: Uint8Array;
  /** Called when the daemon refused it: the view stays as it was before. */
  refused?: (error: unknown) => void;
}
export interface ViewEvents {
  frame: (frame: ViewFrame, payload: Uint8Array, latencyMs: number) => void;
  error: (error: Error) => void;
  /** Whether the last frame still waits to be drawn. While it does, no state is sent; goOn() says that
   * its drawing has begun. */
  busy?: () => boolean;
  /** The least level of frames of a hand that moves: where the GPU is slow they are coarse on any link. */
  leastLevel?: () => number;
}

const GIVE_UP_MS = 1500; // a state whose frame does not come does not block the next for longer
const REST_MS = 250; // a hand that has not moved for so long rests

interface Sent {
  sequence: bigint;
  atMs: number;
  /** Of the pace, when it was sent. */
  level: number;
  /** The hand moved: not a single change, nor the exact frame at rest. */
  moving: boolean;
}

export class LightView {
  private readonly client: Client;
  private readonly events: ViewEvents;
  private readonly id: bigint;
  private sequence = 0n;
  private outstanding: Sent[] = [];
  private making = false;
  private pace = new Pace(1);
  private level = 0; // of the newest state that was sent
  private setAtMs = -Infinity;
  private receivedAtMs = -Infinity; // when a frame came last
  private movedAtMs = -Infinity; // when a state was sent last
  private follows = false; // the newest state came while the hand moved, or before the last one's frame
  private timer: ReturnType<typeof setTimeout> | undefined;
  private resting: ReturnType<typeof setTimeout> | undefined;
  private next: ((level: number) => Promise<ViewChange>) | null = null;
  private last: ((level: number) => Promise<ViewChange>) | null = null;
  private exact = true; // the newest frame is as it was asked for
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
    this.outstanding = [{ sequence: 0n, atMs: performance.now(), level: 0, moving: false }];
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

  /** Whether the frames that follow have levels (LEVELS): coefficients and pictures have. */
  useLevels(on: boolean): void {
    this.pace = new Pace(on ? LEVELS.length : 1);
  }

  /** States whose frame has not come, the one that is being made included. */
  get waits(): number {
    return this.outstanding.length + (this.making ? 1 : 0);
  }
  /** Of LEVELS, of the newest state. */
  get sentLevel(): number {
    return this.level;
  }
  /** How the pace is now, for displays and tests. */
  get pacing(): { outstanding: number; level: number } {
    return { outstanding: this.pace.outstanding, level: this.pace.level };
  }

  private watch(): void {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      for (const { moving, level } of this.outstanding)
        if (moving) this.pace.answered(GIVE_UP_MS, level);
      this.outstanding = [];
      this.send();
    }, GIVE_UP_MS);
  }

  /** Replaces the change that waits. It is made when it is sent: `make` says what differs then,
   * for frames of a level. */
  set(make: (level: number) => Promise<ViewChange>): void {
    this.next = this.last = make;
    const now = performance.now();
    this.follows = this.waits > 0 || now - this.setAtMs < REST_MS;
    this.setAtMs = now;
    this.send();
  }

  /** Whether no frame is awaited, no change waits, and the newest state was drawn in full. */
  get idle(): boolean {
    return !this.waits && !this.next && !this.level && this.exact;
  }

  /** The frame that came last is being drawn. */
  goOn(): void {
    this.send();
  }

  private send(): void {
    if (this.making || this.outstanding.length >= this.pace.outstanding) return;
    const make = this.next;
    if (!make || this.closed) return;
    const now = performance.now();
    // Where nothing is drawn (a tab behind others) states go out all the same, but seldom.
    if (this.events.busy?.() && now - this.receivedAtMs < GIVE_UP_MS) return this.watch();
    const moving =
      this.follows || this.outstanding.length > 0 || now - this.movedAtMs < REST_MS;
    if (!moving) this.pace.began();
    this.movedAtMs = now;
    this.next = null;
    const least = Math.min(this.events.leastLevel?.() ?? 0, this.pace.levels - 1);
    this.put(make, moving ? Math.max(this.pace.level, least) : 0, moving);
  }

  private put(
    make: (level: number) => Promise<ViewChange>,
    level: number,
    moving: boolean,
  ): void {
    this.making = true;
    this.level = level;
    const paced = this.pace.level;
    make(level)
      .then((change) => {
        this.making = false;
        if (this.closed) return;
        this.sequence++;
        const { sequence } = this;
        const atMs = performance.now();
        this.outstanding.push({ sequence, atMs, level: paced, moving });
        this.watch();
        this.client
          .request(
            Type.ViewSet,
            ViewSetRequestSchema,
            {
              view: this.id,
              sequence,
              state: { ...change.state, fields: change.fields },
            },
            ViewSetAnswerSchema,
            change.payload,
          )
          .catch((error: unknown) => {
            this.outstanding = this.outstanding.filter((one) => one.sequence !== sequence);
            if (!this.closed) change.refused?.(error);
            this.failed(error);
          });
        this.send();
      })
      .catch((error: unknown) => {
        this.making = false;
        this.failed(error);
      });
  }
  private failed(error: unknown): void {
    if (this.closed) return;
    this.events.error(error as Error);
    this.send();
  }

  private received(frame: ViewFrame, payload: Uint8Array): void {
    if (this.closed || (!frame.colors && !frame.image && !frame.error && !frame.equal)) return;
    this.client.notify(Type.ViewAck, ViewAckSchema, { view: this.id, shown: frame.frame });
    const now = performance.now();
    this.receivedAtMs = now;
    const own = this.outstanding.find(({ sequence }) => sequence === frame.sequence);
    const delayMs = now - (own?.atMs ?? this.outstanding[0]?.atMs ?? now);
    if (own?.moving) this.pace.answered(delayMs, own.level);
    this.exact = !(frame.colors ?? frame.image)?.cost?.reduced;
    if (frame.error) this.events.error(new RelightError(frame.error));
    else this.events.frame(frame, payload, delayMs);
    this.outstanding = this.outstanding.filter(({ sequence }) => sequence > frame.sequence);
    if (!this.outstanding.length) clearTimeout(this.timer);
    this.send(); // which sets the timer anew where a frame waits to be drawn
    this.rest();
  }

  // The state that rests is asked for in full.
  private rest(): void {
    clearTimeout(this.resting);
    if (!this.level || this.closed) return;
    const wait = Math.max(0, this.setAtMs + REST_MS - performance.now());
    this.resting = setTimeout(() => {
      if (this.waits || this.next || performance.now() < this.setAtMs + REST_MS) this.rest();
      else if (this.last) this.put(this.last, 0, false);
    }, wait + 10);
  }

  close(): void {
    this.closed = true;
    clearTimeout(this.timer);
    clearTimeout(this.resting);
    this.client
      .request(Type.ViewClose, ViewCloseRequestSchema, { view: this.id }, ViewCloseAnswerSchema)
      .catch(() => undefined);
  }
}
