// Where frames come from: the rear camera, or, without one, the pictures of the map's keyframes.

import { path, request, requestJson } from "../api.js";
import { gravity, watchOrientation } from "./gravity.js";
import { CameraLearner, focalFor } from "./known-camera.js";
import { say } from "./words.js";

const MAX_SIDE_PX = 640;
const JPEG_QUALITY = 0.85;
const SIMULATED_FPS = 3;

/** The device's camera. */
export class Camera {
  constructor(video) {
    this.video = video;
    this.canvas = document.createElement("canvas");
    this.scale = 1;
  }

  /** Ask for the camera; throws an `Error` with a sentence for the person. Needs a click. */
  async open() {
    if (!navigator.mediaDevices?.getUserMedia) throw new Error(say("error.camera.insecure"));
    await watchOrientation();
    const video = { facingMode: { ideal: "environment" }, width: { ideal: 1280 }, height: { ideal: 960 } };
    try {
      this.stream = await navigator.mediaDevices.getUserMedia({ video, audio: false });
    } catch (error) {
      throw new Error(cameraWords(error));
    }
    this.video.srcObject = this.stream;
    this.video.hidden = false;
    await this.video.play();
    this.learner = new CameraLearner(this.intrinsics !== null);
  }

  /** Whether there is a picture to take. */
  get ready() {
    return this.video.readyState >= HTMLMediaElement.HAVE_CURRENT_DATA && this.video.videoWidth > 0;
  }

  /** Return the present picture: `{blob, hints, size}`. `scale` below 1 makes it smaller than usual. */
  async take() {
    const [width, height] = this.pictureSize();
    Object.assign(this.canvas, { width, height });
    const hints = { timestamp: performance.now() / 1000 };
    const known = this.learner.isStated ? this.intrinsics : null;
    if (known) hints.camera = known;
    const down = gravity();
    if (down) hints.gravity = down.map((value) => Number(value.toFixed(4)));
    this.canvas.getContext("2d", { alpha: false }).drawImage(this.video, 0, 0, width, height);
    const blob = await new Promise((resolve) => this.canvas.toBlob(resolve, "image/jpeg", JPEG_QUALITY));
    return { blob, hints, size: [width, height] };
  }

  /** Return the camera as the server takes it, from the focal length that is remembered; null where none is. */
  get intrinsics() {
    const [width, height] = this.pictureSize();
    const focalPx = focalFor(width, height);
    const params = [focalPx, (width - 1) / 2, (height - 1) / 2];
    return focalPx && { model: "SIMPLE_PINHOLE", width, height, params };
  }

  pictureSize() {
    const { videoWidth, videoHeight } = this.video;
    const shrink = (this.scale * MAX_SIDE_PX) / Math.max(videoWidth, videoHeight);
    return [videoWidth, videoHeight].map((side) => Math.round(side * Math.min(1, shrink)));
  }

  close() {
    for (const track of this.stream?.getTracks() ?? []) track.stop();
    this.video.hidden = true;
  }
}

/** A phone that isn't there: it shows what the scanner saw, keyframe after keyframe. */
export class SimulatedCamera {
  constructor(venue) {
    this.venue = venue;
    this.at = 0;
    this.next = 0;
    this.ready = true;
    this.scale = 1;
    this.isSimulated = true;
  }

  async open() {
    const { map_version: version } = await requestJson(path("venues", this.venue));
    if (version === null) throw new Error(say("lost.no_map"));
    this.base = path("venues", this.venue, "maps", String(version), "keyframes");
    const keyframes = await requestJson(this.base);
    this.keyframes = keyframes.filter((keyframe) => keyframe.picture);
    if (!this.keyframes.length) throw new Error(say("error.pictures"));
  }

  async take() {
    const wait = this.next - performance.now();
    if (wait > 0) await new Promise((resolve) => setTimeout(resolve, wait));
    this.next = performance.now() + 1000 / SIMULATED_FPS;
    const { keyframe } = this.keyframes[this.at % this.keyframes.length];
    this.at += 1;
    const response = await request(`${this.base}/${keyframe}/picture?width=${MAX_SIDE_PX}`);
    return { blob: await response.blob(), hints: { timestamp: performance.now() / 1000 }, size: null };
  }

  close() {}
}

function cameraWords(error) {
  if (error.name === "NotAllowedError") return say("error.camera.denied");
  if (error.name === "NotFoundError" || error.name === "OverconstrainedError") return say("error.camera.none");
  return say("error.camera", { reason: error.message });
}
