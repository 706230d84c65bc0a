// A session and its WebSocket: frames out at the rate at which answers come back, a new connection when one breaks.

import { ApiError, openStream, path, request, requestJson } from "../api.js";

const MAX_FPS = 10;
// Frames on the way at once: one is computed while the next one travels.
const MAX_UNANSWERED = 2;
// Without any answer for this time the connection counts as dead, though nobody said so. A first search takes seconds.
const SILENCE_MS = 15_000;
const FIRST_RETRY_MS = 400;
const LAST_RETRY_MS = 5000;
// Frames are made smaller while this many bytes wait to be sent, and larger again when few do.
const MUCH_BUFFERED = 120_000;
const SCALES = [1, 0.75, 0.5];
const CLEAR_FRAMES = 50;
const CLOSE_REPLACED = 4000;
const CLOSE_GONE = 4404;

export class SessionStream {
  /** `on` has the listeners `answer(body, sentAt)`, `state("open" | "lost" | "replaced")` and `error(error)`. */
  constructor(venue, camera, wishes, on) {
    Object.assign(this, { venue, camera, wishes, on });
    this.session = null;
    this.socket = null;
    this.running = false;
    this.retryMs = FIRST_RETRY_MS;
    this.sent = new Map();
    this.level = 0;
    this.clear = 0;
    // Frames of the present connection that the server may have answered for the destination before.
    this.former = 0;
    this.received = 0;
    this.telling = null;
  }

  /** Begin the session before there is a camera; what goes wrong is said when it runs. */
  async prepare() {
    await this.begin().catch(() => {});
  }

  /** Run until `stop`, whatever happens to the connection. */
  async run() {
    this.running = true;
    while (this.running) {
      try {
        if (!this.session) await this.begin();
        const code = await this.connection();
        if (code === CLOSE_REPLACED) return this.end("replaced");
        if (code === CLOSE_GONE) this.session = null;
      } catch (error) {
        if (error instanceof ApiError && error.status >= 400 && error.status < 500) {
          this.running = false;
          this.on.error(error);
          return undefined;
        }
      }
      if (!this.running) break;
      this.on.state("lost");
      await pause(this.retryMs);
      this.retryMs = Math.min(LAST_RETRY_MS, this.retryMs * 2);
      // A refused WebSocket doesn't say why: the session may be over, after a long time without a connection.
      if (this.session && this.running) await this.check();
    }
    return undefined;
  }

  stop() {
    this.running = false;
    this.socket?.close();
    if (this.session) request(path("sessions", this.session), { method: "DELETE" }).catch(() => {});
  }

  /** Change destination or language; they also hold for a session that has to be begun anew. */
  change(wishes) {
    Object.assign(this.wishes, wishes);
    if ("destination" in wishes) this.former = Infinity;
    return this.tell();
  }

  /** Tell the server what is wished now, one thing after the other: two changes must not overtake each other. */
  tell() {
    this.telling ??= this.tellAll().finally(() => {
      this.telling = null;
    });
    return this.telling;
  }

  async tellAll() {
    while (this.session && this.told !== JSON.stringify(this.wishes)) {
      const { language, destination } = this.wishes;
      const wishes = JSON.stringify(this.wishes);
      try {
        await requestJson(path("sessions", this.session), { method: "PATCH", json: { language, destination } });
      } catch (error) {
        // What the server refuses is not told again.
        if (error.status > 0 && error.status < 500) {
          this.told = wishes;
          throw error;
        }
        await pause(LAST_RETRY_MS / 5);
        if (!this.running) return;
        continue;
      }
      this.told = wishes;
    }
    // Frames that are sent from now on are answered for the present destination.
    this.former = this.received;
  }

  async begin() {
    const told = JSON.stringify(this.wishes);
    const wishes = Object.fromEntries(Object.entries(this.wishes).filter(([, value]) => value));
    const created = await requestJson("sessions", { method: "POST", json: { venue: this.venue, ...wishes } });
    Object.assign(this, { session: created.session, told });
  }

  async check() {
    try {
      await requestJson(`${path("sessions", this.session)}?points=0`);
    } catch (error) {
      if (error.status === 404) this.session = null;
    }
  }

  /** Stream over one connection; returns the code that it was closed with. */
  connection() {
    return new Promise((resolve) => {
      const socket = openStream(this.session);
      const open = { socket, received: 0, answered: 0, heardAt: performance.now(), done: false };
      this.socket = socket;
      this.sent.clear();
      socket.addEventListener("open", () => {
        open.heardAt = performance.now();
        this.received = 0;
        this.on.state("open");
        // What was chosen while there was no connection, or while the session began.
        this.tell().catch(() => {});
        this.pump(open).catch((error) => {
          this.on.error(error);
          this.stop();
        });
      });
      socket.addEventListener("message", (event) => this.answer(open, JSON.parse(event.data)));
      socket.addEventListener("close", (event) => {
        open.done = true;
        resolve(event.code);
      });
    });
  }

  async pump(open) {
    let next = 0;
    while (!open.done && this.running) {
      await pause(Math.max(5, next - performance.now()));
      const unanswered = open.received - open.answered;
      if (unanswered && performance.now() - open.heardAt > SILENCE_MS) {
        open.socket.close();
        return;
      }
      const idle = document.hidden || !this.camera.ready;
      if (idle && !unanswered) open.heardAt = performance.now();
      if (idle || unanswered >= MAX_UNANSWERED || open.socket.bufferedAmount > MUCH_BUFFERED) {
        this.adapt(open.socket.bufferedAmount);
        next = performance.now() + 15;
        continue;
      }
      next = performance.now() + 1000 / MAX_FPS;
      const { blob, hints, size } = await this.camera.take();
      const data = await blob?.arrayBuffer();
      // The server may have closed the connection while the picture was taken; its close event comes later.
      if (open.socket.readyState !== WebSocket.OPEN || !data) continue;
      if (!unanswered) open.heardAt = performance.now();
      open.socket.send(JSON.stringify(hints));
      open.socket.send(data);
      open.received += 1;
      this.received = open.received;
      this.sent.set(open.received, { at: performance.now(), size });
      this.adapt(open.socket.bufferedAmount);
    }
  }

  answer(open, body) {
    open.heardAt = performance.now();
    if (body.received) open.answered = Math.max(open.answered, body.received);
    this.retryMs = FIRST_RETRY_MS;
    const sent = this.sent.get(body.received) ?? null;
    for (const number of this.sent.keys()) if (number <= body.received) this.sent.delete(number);
    if (body.received <= this.former) body.guidance = null;
    if (body.session) this.on.answer(body, sent);
    else if (body.code !== "not_found") this.on.refused?.(body);
  }

  adapt(buffered) {
    if (buffered > MUCH_BUFFERED) {
      this.level = Math.min(SCALES.length - 1, this.level + 1);
      this.clear = 0;
    } else if (buffered === 0) {
      this.clear += 1;
    }
    if (this.clear > CLEAR_FRAMES) {
      this.level = Math.max(0, this.level - 1);
      this.clear = 0;
    }
    this.camera.scale = SCALES[this.level];
  }

  end(state) {
    this.running = false;
    this.on.state(state);
  }
}

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
