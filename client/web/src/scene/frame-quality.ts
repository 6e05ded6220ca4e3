// SPDX-License-Identifier: MIT
// How finely frames are drawn while something moves: where the GPU is slow, without smoothing of
// edges, then at half the width and height. What rests is drawn in full.

/** 0: in full, four samples a pixel; 1: one sample; 2: one sample at half the width and height. */
export type Quality = 0 | 1 | 2;

/** A frame that takes longer is too slow for a hand that moves. */
const SLOW_MS = 40;
/** Without a change for so long, the picture rests. */
export const REST_MS = 150;
const FIRST_RETRY_MS = 1000;
const LAST_RETRY_MS = 60_000;

/** Half resolution is not enough where its frames take so long. */
const STILL_SLOW_MS = 90;
/** It is enough again, with some more coefficients, where so many in a row take no longer. */
const FAST_AGAIN_MS = 60;
const MANY_FAST = 10;

export class FrameQuality {
  /** Of frames of something that moves. */
  moving: Quality = 0;
  /** Of LEVELS (pace.ts), the least that moving frames are to have: fewer coefficients are less work. */
  leastLevel = 0;
  private nFast = 0;
  private retryMs = FIRST_RETRY_MS;
  private retryAtMs = 0;

  /** A frame was drawn at this quality, and the GPU took `tookMs` for it. atOnce: it was there at the
   * next animation frame of the display, whose rate may be low; then a finer one is tried. */
  drawn(quality: Quality, tookMs: number, atOnce: boolean, nowMs: number): void {
    if (quality !== this.moving) return; // a picture that rests
    if (quality < 2) this.leastLevel = 0;
    else if (tookMs > SLOW_MS) this.leastLevel = Math.max(this.leastLevel, 1);
    if (quality === 2 && tookMs > STILL_SLOW_MS) this.leastLevel = 2;
    this.nFast = quality === 2 && tookMs < FAST_AGAIN_MS ? this.nFast + 1 : 0;
    if (this.nFast >= MANY_FAST) this.leastLevel = Math.min(this.leastLevel, 1);
    if (tookMs > SLOW_MS && quality < 2) {
      this.moving = (quality + 1) as Quality;
      this.retryAtMs = nowMs + this.retryMs;
      this.retryMs = Math.min(2 * this.retryMs, LAST_RETRY_MS); // it was tried, perhaps again
    } else if (atOnce && quality > 0 && nowMs >= this.retryAtMs) {
      this.moving = (quality - 1) as Quality;
    }
  }
}
