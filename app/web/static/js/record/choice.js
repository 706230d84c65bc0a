// Which frames of a film are kept: the sharpest one of each step of motion.

// Motion from one kept frame to the next as a ratio of the picture's longer side, and the part of such a step in which
// the sharpest frame is looked for. The server chooses frames of a video by the same numbers.
const STEP = 0.06;
const LEAST = 0.6;
const MOST = 1.2;
// A step in one go: frames between are missing, and this one is probably blurred.
const FAST = 2.5;
const STILL_S = 4;

/** Takes measured frames one by one; `keep` is called with what `take` made of a chosen one. */
export class Choice {
  constructor() {
    this.way = null;
    this.best = null;
    this.movedS = 0;
  }

  /** Return the picture to keep, or null. `take()` makes the present picture, only where it may be kept. */
  async add({ step, sharpness }, timeS, take) {
    if (this.way === null) {
      this.way = 0;
      this.movedS = timeS;
      return take();
    }
    this.way += step;
    if (step > STEP / 20) this.movedS = timeS;
    this.fast = step > FAST * STEP;
    this.still = timeS - this.movedS > STILL_S;
    if (this.way < LEAST * STEP) return null;
    if (this.best === null || sharpness > this.best.sharpness) {
      this.best = { sharpness, way: this.way, picture: await take() };
    }
    if (this.way < MOST * STEP) return null;
    const { picture, way } = this.best;
    this.best = null;
    this.way -= way;
    return picture;
  }
}
