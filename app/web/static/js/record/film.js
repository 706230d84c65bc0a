// Films: looks at the camera's picture some times a second and keeps the frames that a map needs.

import { gravity } from "../go/gravity.js";
import { Choice } from "./choice.js";
import { MotionMeter } from "./motion.js";

const FPS = 12;
const MAX_SIDE_PX = 1280;
const JPEG_QUALITY = 0.85;

export class Film {
  /** `keep(frame)` gets `{picture, timeS, gravity}` of each frame that is kept, `hint(name)` what the person should do. */
  constructor(video, startedAt, { keep, hint, mayKeep }) {
    Object.assign(this, { video, startedAt, keep, hint, mayKeep });
    this.canvas = document.createElement("canvas");
    this.meter = new MotionMeter();
    this.choice = new Choice();
    this.running = false;
  }

  /** Run until `stop`. */
  async run() {
    this.running = true;
    let next = 0;
    while (this.running) {
      await pause(Math.max(5, next - performance.now()));
      next = performance.now() + 1000 / FPS;
      const ready = this.video.readyState >= HTMLMediaElement.HAVE_CURRENT_DATA && this.video.videoWidth > 0;
      if (!ready || document.hidden) continue;
      const refusal = await this.mayKeep();
      if (!this.running) return;
      if (refusal) {
        this.hint(refusal);
        continue;
      }
      const timeS = (Date.now() - this.startedAt) / 1000;
      const kept = await this.choice.add(this.meter.measure(this.video), timeS, () => this.take(timeS));
      if (!this.running) return;
      if (kept?.picture) await this.keep(kept);
      this.hint(this.choice.fast ? "fast" : this.choice.still ? "still" : "steady");
    }
  }

  stop() {
    this.running = false;
  }

  async take(timeS) {
    const { videoWidth, videoHeight } = this.video;
    const shrink = Math.min(1, MAX_SIDE_PX / Math.max(videoWidth, videoHeight));
    const [width, height] = [videoWidth, videoHeight].map((side) => Math.round(side * shrink));
    Object.assign(this.canvas, { width, height });
    const down = gravity();
    this.canvas.getContext("2d", { alpha: false }).drawImage(this.video, 0, 0, width, height);
    const picture = await new Promise((resolve) => this.canvas.toBlob(resolve, "image/jpeg", JPEG_QUALITY));
    return { picture, timeS, gravity: down };
  }
}

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
