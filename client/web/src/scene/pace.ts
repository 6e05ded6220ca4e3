// SPDX-License-Identifier: MIT
// How a view is paced on its link: how many states are outstanding, and how coarse the frames of a
// hand that moves are. It measures nothing but answers: their delay, and how many overlap.

/** A rate that looks steady, and a delay that a hand can follow. */
const WANTED_MS = 1000 / 18;
export const MOST_DELAY_MS = 200;
/** States that may be outstanding at most. */
export const MOST_OUTSTANDING = 4;
/** Rows of a cluster in coefficients (PROTOCOL, COLORS), and the side of pictures, by level. */
export const LEVELS = [
  { rank: 0, side: 1 },
  { rank: 16, side: 0.6 },
  { rank: 8, side: 0.4 },
] as const;
/** Answers that agree before a level is left. */
const AGREE = 3;
/** Answers before a finer level is tried again: doubled each time it does not hold. */
const FIRST_PATIENCE = 45;
const MOST_PATIENCE = 720;

export class Pace {
  /** States that may be outstanding. */
  outstanding = 1;
  /** Of LEVELS. */
  level = 0;
  private delayMs = 0; // running mean
  private leastMs = Infinity; // of this level: what the link takes where nothing queues
  private late = 0;
  private early = 0;
  private patience = FIRST_PATIENCE;
  private tried = false; // the level was refined and has not held yet
  readonly levels: number;

  /** levels: those that make answers smaller; 1 for colours. */
  constructor(levels: number = LEVELS.length) {
    this.levels = levels;
  }

  /** A hand begins to move: the link may have changed since the last one. */
  began(): void {
    this.leastMs = Infinity;
    this.outstanding = 1;
  }

  /** An answer to a state of a hand that moves, made at `level`. */
  answered(delayMs: number, level: number): void {
    if (level !== this.level) return; // sent before the level changed
    this.delayMs = this.delayMs ? 0.6 * this.delayMs + 0.4 * delayMs : delayMs;
    const mean = this.delayMs;
    // With n outstanding there are n answers in a delay; more than the least delay needs would
    // queue.
    this.leastMs = Math.min(this.leastMs, delayMs);
    const needed = Math.ceil(this.leastMs / WANTED_MS);
    this.outstanding = Math.max(1, Math.min(MOST_OUTSTANDING, needed));
    this.late = mean > MOST_DELAY_MS ? this.late + 1 : 0;
    this.early = mean < MOST_DELAY_MS / 2 ? this.early + 1 : 0;
    if (this.late >= AGREE) this.coarser();
    else if (this.early >= this.patience) this.finer();
  }

  private coarser(): void {
    this.late = 0;
    if (this.level + 1 >= this.levels) return;
    if (this.tried) this.patience = Math.min(MOST_PATIENCE, 2 * this.patience);
    this.to(this.level + 1);
    this.tried = false;
  }
  private finer(): void {
    this.early = 0;
    if (!this.level) return;
    this.to(this.level - 1);
    this.tried = true;
  }
  private to(level: number): void {
    this.level = level;
    this.delayMs = 0;
    this.leastMs = Infinity;
    this.late = this.early = 0;
  }
}
