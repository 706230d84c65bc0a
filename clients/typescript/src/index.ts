// A client of a Roomfix server for browsers and Node.

import type {
  Axes,
  Build,
  CreatedToken,
  Inspection,
  LocateResult,
  Pose,
  Problem,
  PushedFrame,
  Session,
  TrackedFrame,
  Venue,
} from "./answers.js";

export * from "./answers.js";

/** Fields of /locate and of a session's frames; see docs/http.md of the server. */
export interface LocateFields {
  venue?: string;
  floor?: string;
  area?: string;
  camera?: string | number[] | object;
  gravity?: string | [number, number, number];
  prior?: { position: { x: number; y: number; z: number }; radius_m: number };
  method?: "auto" | "rgbd" | "vdm" | "anchor";
  /** Above 0, at most 1: refuse a pose whose confidence is below 1 - max_risk. */
  max_risk?: number;
  axes?: Axes;
  device_pose?: Pose;
  /** Further frames of a burst or a rig, their motion and, where they differ, their cameras: one entry for each. */
  images?: Blob[];
  motion?: Pose[];
  cameras?: (string | number[] | object | null)[];
}

export interface FrameFields {
  camera?: string | number[] | object;
  gravity?: string | [number, number, number];
  motion?: Pose;
  timestamp?: number;
  axes?: Axes;
  device_pose?: Pose;
}

export interface SessionFields {
  camera?: string | number[] | object;
  destination?: string;
  language?: string;
}

/** What the server refused: status, a stable code, and a sentence that says what to change. */
export class RoomfixError extends Error {
  constructor(
    readonly status: number,
    readonly code: string,
    detail: string,
    readonly retryAfterS: number | null = null,
  ) {
    super(detail);
    this.name = "RoomfixError";
  }
}

const PASSING = [429, 502, 503, 504];
const LONGEST_PAUSE_S = 30;
// Fields with one entry for each of several frames.
const LISTS = ["motion", "cameras"];

/** A server at an address, called with a key or token. A call that meets a busy server is made again. */
export class Roomfix {
  private readonly url: string;

  constructor(
    url: string,
    private readonly key?: string,
    private readonly retries = 3,
  ) {
    this.url = url.replace(/\/+$/, "");
  }

  /** Locate a picture. */
  locate(picture: Blob, fields: LocateFields = {}): Promise<LocateResult> {
    return this.call("POST", "/locate", () => form(picture, fields));
  }

  /** Return the venues that the key may use. */
  venues(): Promise<Venue[]> {
    return this.call("GET", "/venues");
  }

  /** Make a short-lived token for a phone, on your own server: a page or app gets the token, never the key. */
  createToken(venue: string, expiresInS = 3600): Promise<CreatedToken> {
    return this.call("POST", "/tokens", () => JSON.stringify({ venue, expires_in_s: expiresInS }));
  }

  /** Start a session. */
  createSession(venue: string, fields: SessionFields = {}): Promise<Session> {
    return this.call("POST", "/sessions", () => JSON.stringify({ venue, ...fields }));
  }

  /** Track a frame of a session. */
  track(session: string, picture: Blob, fields: FrameFields = {}): Promise<TrackedFrame> {
    return this.call("POST", `/sessions/${encodeURIComponent(session)}/frames`, () => form(picture, fields));
  }

  /** End a session. */
  endSession(session: string): Promise<void> {
    return this.call("DELETE", `/sessions/${encodeURIComponent(session)}`);
  }

  /** Push the newest frame of a monitoring camera. */
  pushAnchorFrame(camera: string, picture: Blob): Promise<PushedFrame> {
    return this.call("POST", `/anchors/${encodeURIComponent(camera)}/frames`, () => form(picture, {}));
  }

  /** Return what a scan holds and what a build would do with it; nothing is built. */
  inspect(archive: Blob, options: object = {}): Promise<Inspection> {
    return this.call("POST", "/database/inspect", () => {
      const data = new FormData();
      data.set("options", JSON.stringify(options));
      data.set("archive", archive, "scan");
      return data;
    });
  }

  /** Submit a scan and return its build; sent again, it is the same build. */
  async build(archive: Blob, venue: string, options: object): Promise<Build> {
    const headers = { "Idempotency-Key": crypto.randomUUID() };
    const submitted = await this.call<{ build: string }>(
      "POST",
      "/database/build",
      () => {
        const data = new FormData();
        data.set("venue", venue);
        data.set("options", JSON.stringify(options));
        data.set("archive", archive, "scan");
        return data;
      },
      headers,
    );
    return this.buildStatus(submitted.build);
  }

  /** Return where a build is. */
  buildStatus(build: string): Promise<Build> {
    return this.call("GET", `/database/builds/${encodeURIComponent(build)}`);
  }

  /** Return a build when it has succeeded, telling its progress; throws when it has not. */
  async waitForBuild(build: string, onProgress: (status: Build) => void = () => {}, everyS = 1): Promise<Build> {
    for (;;) {
      const status = await this.buildStatus(build);
      onProgress(status);
      if (status.state === "succeeded") return status;
      if (status.state !== "queued" && status.state !== "running") {
        throw new Error(status.error ?? `The build was ${status.state}.`);
      }
      await pause(everyS);
    }
  }

  /** Open the stream of a session; the key goes in a subprotocol, never in the address. */
  stream(session: string, WebSocketClass: typeof WebSocket = WebSocket): FrameStream {
    const address = `${this.url.replace(/^http/, "ws")}/sessions/${encodeURIComponent(session)}/stream`;
    const offered = this.key === undefined ? ["roomfix"] : ["roomfix", `roomfix.key.${this.key}`];
    return new FrameStream(new WebSocketClass(address, offered));
  }

  private async call<T>(
    method: string,
    path: string,
    body?: () => string | FormData,
    more: Record<string, string> = {},
  ): Promise<T> {
    for (let attempt = 0; ; attempt += 1) {
      try {
        return await this.once<T>(method, path, body?.(), more);
      } catch (error) {
        const isPassing = error instanceof RoomfixError ? PASSING.includes(error.status) : error instanceof TypeError;
        if (!isPassing || attempt >= this.retries) throw error;
        const asked = error instanceof RoomfixError ? error.retryAfterS : null;
        await pause(Math.min(asked ?? 0.5 * 2 ** attempt, LONGEST_PAUSE_S));
      }
    }
  }

  private async once<T>(
    method: string,
    path: string,
    body: string | FormData | undefined,
    more: Record<string, string>,
  ): Promise<T> {
    const headers = new Headers(more);
    if (this.key !== undefined) headers.set("Authorization", `Bearer ${this.key}`);
    if (typeof body === "string") headers.set("Content-Type", "application/json");
    const init: RequestInit = body === undefined ? { method, headers } : { method, headers, body };
    const answer = await fetch(`${this.url}${path}`, init);
    const text = await answer.text();
    if (!answer.ok) throw errorOf(answer, text);
    return (text === "" ? undefined : JSON.parse(text)) as T;
  }
}

/** A session's stream: frames in, answers out; of frames that wait the server answers the newest. */
export class FrameStream {
  onAnswer: (answer: TrackedFrame & { received: number }) => void = () => {};
  onProblem: (problem: Problem) => void = () => {};
  onClose: (code: number, reason: string) => void = () => {};
  /** Resolves when frames can be sent. */
  readonly opened: Promise<void>;

  constructor(private readonly socket: WebSocket) {
    this.opened = new Promise((resolve, reject) => {
      socket.addEventListener("open", () => resolve());
      socket.addEventListener("error", () => reject(new Error("The stream can't be opened.")));
    });
    socket.addEventListener("message", (event: MessageEvent) => {
      const body = JSON.parse(String(event.data)) as (TrackedFrame & { received: number }) | Problem;
      if ("tracking" in body) this.onAnswer(body);
      else this.onProblem(body);
    });
    socket.addEventListener("close", (event: CloseEvent) => this.onClose(event.code, event.reason));
  }

  /** Send a frame and what is known of it. */
  send(picture: Blob | ArrayBuffer, fields: FrameFields = {}): void {
    if (Object.keys(fields).length > 0) this.socket.send(JSON.stringify(fields));
    this.socket.send(picture);
  }

  /** Send pictures of a video element until the returned function is called (browsers). */
  sendVideo(video: HTMLVideoElement, everyMs = 100, quality = 0.9): () => void {
    const canvas = document.createElement("canvas");
    const timer = setInterval(() => {
      if (video.videoWidth === 0 || this.socket.bufferedAmount > 0) return;
      canvas.width = video.videoWidth;
      canvas.height = video.videoHeight;
      canvas.getContext("2d")?.drawImage(video, 0, 0);
      const timestamp = performance.now() / 1000;
      canvas.toBlob((blob) => blob !== null && this.send(blob, { timestamp }), "image/jpeg", quality);
    }, everyMs);
    return () => clearInterval(timer);
  }

  close(): void {
    this.socket.close();
  }
}

function form(picture: Blob, fields: object): FormData {
  const data = new FormData();
  data.set("image", picture, "image");
  for (const [name, value] of Object.entries(fields) as [string, unknown][]) {
    if (value === undefined || value === null) continue;
    if (name === "images") {
      for (const each of value as Blob[]) data.append(name, each, "image");
      continue;
    }
    if (Array.isArray(value) && LISTS.includes(name)) {
      data.set(name, JSON.stringify(value));
      continue;
    }
    const isText = typeof value === "string";
    data.set(name, isText ? value : Array.isArray(value) ? value.join(",") : JSON.stringify(value));
  }
  return data;
}

function errorOf(answer: Response, text: string): RoomfixError {
  const after = Number(answer.headers.get("Retry-After") ?? "");
  const retryAfterS = Number.isFinite(after) && after > 0 ? after : null;
  try {
    const body = JSON.parse(text) as Problem;
    if (body.code && body.detail) return new RoomfixError(answer.status, body.code, body.detail, retryAfterS);
  } catch {
    // A proxy in between answers in its own words.
  }
  return new RoomfixError(answer.status, "http_error", `The server answered with status ${answer.status}.`, retryAfterS);
}

function pause(seconds: number): Promise<void> {
  return new Promise((resolve) => setTimeout(resolve, 1000 * seconds));
}
