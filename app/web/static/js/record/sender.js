// Sends frames while others are filmed; goes on by itself after a cut or a restart of the server.

import { path, request } from "../api.js";

const AT_ONCE = 2;
const FIRST_RETRY_MS = 500;
const LAST_RETRY_MS = 5000;
const IDLE_MS = 250;

export class Sender {
  /** `on` has the listeners `sent()`, `offline(isOffline)` and `refused(error)`. */
  constructor(recording, pending, on) {
    Object.assign(this, { recording, pending, on });
    this.running = false;
    this.retryMs = FIRST_RETRY_MS;
    this.wake = () => {};
    addEventListener("online", () => this.wake());
  }

  /** Run until `stop`. */
  async run() {
    if (this.running) return;
    this.running = true;
    while (this.running) {
      const frames = await this.pending.first(this.recording, AT_ONCE);
      if (!frames.length) {
        await this.pause(IDLE_MS);
        continue;
      }
      try {
        await Promise.all(frames.map((frame) => this.send(frame)));
        this.retryMs = FIRST_RETRY_MS;
        this.on.offline(false);
      } catch (error) {
        // What was on its way when it was stopped matters to nobody.
        if (!this.running) return;
        if (!isPassing(error)) {
          this.running = false;
          this.on.refused(error);
          return;
        }
        this.on.offline(true);
        await this.pause(this.retryMs);
        this.retryMs = Math.min(LAST_RETRY_MS, 2 * this.retryMs);
      }
    }
  }

  stop() {
    this.running = false;
    this.wake();
  }

  async send({ number, picture, timeS, gravity }) {
    const query = new URLSearchParams({ time_s: timeS.toFixed(3) });
    if (gravity) query.set("gravity", gravity.map((value) => value.toFixed(4)).join(","));
    const where = `${path("recordings", this.recording, "frames", String(number))}?${query}`;
    await request(where, { method: "PUT", form: picture });
    await this.pending.remove(this.recording, number);
    this.on.sent();
  }

  pause(ms) {
    return new Promise((resolve) => {
      const timer = setTimeout(resolve, ms);
      this.wake = () => {
        clearTimeout(timer);
        resolve();
      };
    });
  }
}

/** Whether an error goes away by itself: no network, a server that starts, or one that has too much to do. */
export const isPassing = (error) => error.status === 0 || error.status === 429 || error.status >= 500;
