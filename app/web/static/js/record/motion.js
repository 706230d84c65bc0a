// How far a picture has moved since the one before, and how sharp it is, measured in small grey pictures.

const SIDE_PX = 96;
// Shifts of the parts of a picture that are tried, as a ratio of the part's side.
const REACH = 0.3;
const PARTS = 2;
// A picture that no shift explains has changed as a whole.
const CHANGED = 1;

/** Measures the frames of a video in their order. */
export class MotionMeter {
  constructor() {
    this.canvas = document.createElement("canvas");
    this.before = null;
  }

  /** Return `{step, sharpness}`: motion as a ratio of the picture's longer side, and the variance of its edges. */
  measure(video) {
    const scale = SIDE_PX / Math.max(video.videoWidth, video.videoHeight);
    const width = Math.round(scale * video.videoWidth);
    const height = Math.round(scale * video.videoHeight);
    if (this.canvas.width !== width || this.canvas.height !== height) {
      Object.assign(this.canvas, { width, height });
      this.before = null;
    }
    const context = this.canvas.getContext("2d", { alpha: false, willReadFrequently: true });
    context.drawImage(video, 0, 0, width, height);
    const gray = grayOf(context.getImageData(0, 0, width, height).data);
    const parts = partsOf(gray, width, height);
    const step = this.before === null ? 0 : motion(this.before, parts) / SIDE_PX;
    this.before = parts;
    return { step, sharpness: sharpness(gray, width, height) };
  }
}

function grayOf(rgba) {
  const gray = new Float32Array(rgba.length / 4);
  for (let i = 0; i < gray.length; i += 1) gray[i] = 0.299 * rgba[4 * i] + 0.587 * rgba[4 * i + 1] + 0.114 * rgba[4 * i + 2];
  return gray;
}

/** Return the variance of the Laplacian. */
function sharpness(gray, width, height) {
  let [sum, squares] = [0, 0];
  for (let y = 1; y < height - 1; y += 1) {
    for (let x = 1; x < width - 1; x += 1) {
      const i = y * width + x;
      const value = gray[i - 1] + gray[i + 1] + gray[i - width] + gray[i + width] - 4 * gray[i];
      sum += value;
      squares += value * value;
    }
  }
  const count = (width - 2) * (height - 2);
  return squares / count - (sum / count) ** 2;
}

/** Return of each part of the picture the sums of its columns and of its rows; these move with the picture. */
function partsOf(gray, width, height) {
  const [w, h] = [Math.floor(width / PARTS), Math.floor(height / PARTS)];
  const parts = [];
  for (let part = 0; part < PARTS * PARTS; part += 1) {
    const [left, top] = [(part % PARTS) * w, Math.floor(part / PARTS) * h];
    const [columns, rows] = [new Float32Array(w), new Float32Array(h)];
    for (let y = 0; y < h; y += 1) {
      for (let x = 0; x < w; x += 1) {
        const value = gray[(top + y) * width + left + x];
        columns[x] += value / h;
        rows[y] += value / w;
      }
    }
    parts.push({ columns, rows });
  }
  return parts;
}

/** Return the mean motion of the parts in pixels. */
function motion(before, after) {
  let sum = 0;
  for (let i = 0; i < after.length; i += 1) {
    sum += Math.hypot(shift(before[i].columns, after[i].columns), shift(before[i].rows, after[i].rows));
  }
  return sum / after.length;
}

/** Return by how many entries one profile is moved against another, between entries by a parabola. */
export function shift(before, after) {
  const reach = Math.floor(REACH * before.length);
  const costs = [];
  for (let move = -reach; move <= reach; move += 1) costs.push(difference(before, after, move));
  const best = costs.indexOf(Math.min(...costs));
  const spread = difference(before, after, 0);
  if (spread < CHANGED) return 0;
  const [left, middle, right] = [costs[best - 1], costs[best], costs[best + 1]];
  if (left === undefined || right === undefined) return best - reach;
  const bend = left - 2 * middle + right;
  return best - reach + (bend > 0 ? (left - right) / (2 * bend) : 0);
}

/** Return the mean absolute difference of two profiles, one moved, apart from a change of brightness. */
function difference(before, after, move) {
  const [from, to] = [Math.max(0, -move), Math.min(before.length, before.length - move)];
  let mean = 0;
  for (let i = from; i < to; i += 1) mean += after[i + move] - before[i];
  mean /= to - from;
  let sum = 0;
  for (let i = from; i < to; i += 1) sum += Math.abs(after[i + move] - before[i] - mean);
  return sum / (to - from);
}
