// The focal length of this phone's camera, as a map or answers have found it; remembered on the phone alone.

const REMEMBERED = "roomfix.camera";
const ROUNDED = 5;
// Answers without a place at the start, after which the camera is taken to be another one.
const FORGOTTEN_AFTER = 8;

/** Remember the focal length of a camera as a ratio of the longer side of its pictures. */
export function rememberCamera({ width, height, focalPx }) {
  const ratio = focalPx / Math.max(width, height);
  if (!(ratio > 0.2 && ratio < 5)) return;
  const shape = shapeOf(width, height);
  localStorage.setItem(REMEMBERED, JSON.stringify({ ratio: Number(ratio.toFixed(ROUNDED)), shape }));
}

/** Return the focal length in pixels for pictures of a size, null where it is not known. */
export function focalFor(width, height) {
  try {
    const { ratio, shape } = JSON.parse(localStorage.getItem(REMEMBERED));
    // Another shape is cut another way out of the sensor, which changes the ratio.
    return Math.abs(shape - shapeOf(width, height)) < 0.01 ? ratio * Math.max(width, height) : null;
  } catch {
    return null;
  }
}

/** Learns the focal length from the answers of a session, and forgets one with which nothing is found. */
export class CameraLearner {
  /** `isStated` says that frames are sent with the focal length that is remembered. */
  constructor(isStated) {
    this.isStated = isStated;
    this.isRight = false;
    this.missed = 0;
  }

  /** Take an answer. */
  answer({ located, camera }) {
    if (located) {
      this.isRight = true;
      if (camera?.source === "search") {
        rememberCamera({ width: camera.width, height: camera.height, focalPx: camera.params[0] });
      }
      return;
    }
    this.missed += 1;
    if (!this.isStated || this.isRight || this.missed < FORGOTTEN_AFTER) return;
    this.isStated = false;
    localStorage.removeItem(REMEMBERED);
  }
}

const shapeOf = (width, height) => Math.max(width, height) / Math.min(width, height);
