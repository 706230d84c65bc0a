// The scan seen from above, as a picture in world metres, and how many points lie at which height.

import { path, request } from "../api.js";

const MAGIC = "RFPTS001";
const MAX_POINTS = 150_000;
// About as many pixels as the board has: what is drawn finer than the screen shows fades away.
const MAX_SIDE_PX = 1000;
const MIN_METRES_PER_PX = 0.015;
// White walls are not to vanish on white paper: each point is half of this colour.
const INK = [10, 98, 208];
// Points behind mirrors and windows must not make the rest small.
const OUTLIER_SHARE = 0.002;

export class ScanPoints {
  constructor(points, colours) {
    Object.assign(this, { points, colours, count: points.length / 3 });
  }

  static async of(venue, version) {
    const response = await request(`${path("venues", venue, "maps", String(version), "points")}?max_points=${MAX_POINTS}`);
    const buffer = await response.arrayBuffer();
    const view = new DataView(buffer);
    const magic = String.fromCharCode(...new Uint8Array(buffer, 0, 8));
    if (magic !== MAGIC) throw new Error("The server sent points that this page can't read: reload the page.");
    const count = view.getUint32(8, true);
    return new ScanPoints(new Float32Array(buffer, 12, 3 * count), new Uint8Array(buffer, 12 + 12 * count, 3 * count));
  }

  /** Return the shares of the points by height, `{from, to, bins}`, without outliers. */
  heights(bins = 60) {
    const z = Float32Array.from({ length: this.count }, (_, i) => this.points[3 * i + 2]).sort();
    const at = (share) => z[Math.min(z.length - 1, Math.max(0, Math.round(share * z.length)))] ?? 0;
    const [from, to] = [at(OUTLIER_SHARE) - 0.1, at(1 - OUTLIER_SHARE) + 0.1];
    const counts = new Array(bins).fill(0);
    for (const value of z) {
      const bin = Math.floor(((value - from) / (to - from)) * bins);
      if (bin >= 0 && bin < bins) counts[bin] += 1;
    }
    const most = Math.max(1, ...counts);
    return { from, to, bins: counts.map((count) => count / most) };
  }

  /** Draw the points between two heights: `{url, width, height, metresPerPx, x, y}`, x and y of the upper left corner. */
  async drawn(zMin, zMax) {
    const inside = [];
    for (let i = 0; i < this.count; i += 1) {
      const z = this.points[3 * i + 2];
      if (z >= zMin && z <= zMax) inside.push(i);
    }
    if (!inside.length) return null;
    const bounds = [0, 1].map((axis) => {
      const values = Float32Array.from(inside, (i) => this.points[3 * i + axis]).sort();
      const skip = Math.floor(OUTLIER_SHARE * values.length);
      return [values[skip] - 0.2, values[values.length - 1 - skip] + 0.2];
    });
    const [[left, right], [bottom, top]] = bounds;
    const metresPerPx = Math.max(MIN_METRES_PER_PX, (right - left) / MAX_SIDE_PX, (top - bottom) / MAX_SIDE_PX);
    const [width, height] = [Math.ceil((right - left) / metresPerPx), Math.ceil((top - bottom) / metresPerPx)];
    const canvas = Object.assign(document.createElement("canvas"), { width, height });
    const context = canvas.getContext("2d");
    const pixels = context.createImageData(width, height);
    for (const i of inside) {
      const u = Math.floor((this.points[3 * i] - left) / metresPerPx);
      const v = Math.floor((top - this.points[3 * i + 1]) / metresPerPx);
      if (u < 0 || v < 0 || u >= width || v >= height) continue;
      const at = 4 * (v * width + u);
      INK.forEach((value, channel) => {
        pixels.data[at + channel] = (this.colours[3 * i + channel] + value) / 2;
      });
      pixels.data[at + 3] = 255;
    }
    context.putImageData(pixels, 0, 0);
    const blob = await new Promise((resolve) => canvas.toBlob(resolve));
    return { url: URL.createObjectURL(blob), width, height, metresPerPx, x: left, y: top };
  }
}
