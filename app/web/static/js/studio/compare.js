// Two versions of the map beside each other: their figures, and what only one of them has seen.

import { byId, el, guarded, showError } from "../dom.js";
import { count, metres } from "../words.js";
import { ScanPoints } from "./scan-image.js";

const CELL_M = 0.05;
const MAX_SIDE_PX = 900;
// Points behind windows must not make the rest small.
const OUTLIER_SHARE = 0.002;
const COLOURS = { both: [96, 112, 122], first: [10, 98, 208], second: [200, 96, 0] };

export class Compare {
  constructor() {
    Object.assign(this, { maps: [], venue: null });
    byId("compare-form").addEventListener("submit", (event) => {
      event.preventDefault();
      guarded(byId("compare"), byId("compare-error"), () => this.compare());
    });
  }

  /** Offer the versions of a venue, newest first. */
  show(maps, venue = null) {
    Object.assign(this, { maps, venue });
    showError(byId("compare-error"), null);
    byId("compare-form").hidden = maps.length < 2;
    byId("compare-result").replaceChildren();
    for (const [id, at] of [["compare-first", 1], ["compare-second", 0]]) {
      byId(id).replaceChildren(...maps.map(({ version }) => el("option", { value: version }, `Version ${version}`)));
      if (maps[at]) byId(id).value = maps[at].version;
    }
  }

  async compare() {
    const { maps, venue } = this;
    const chosen = ["first", "second"].map((id) => maps.find(({ version }) => String(version) === byId(`compare-${id}`).value));
    const [first, second] = await Promise.all(chosen.map(({ version }) => ScanPoints.of(venue.id, version)));
    // Other versions are offered by now.
    if (maps !== this.maps) return;
    const { canvas, shares } = overlay(first, second);
    const names = chosen.map(({ version }) => `version ${version}`);
    const words = [
      `${percent(shares.both)} of the ground is in both (grey)`,
      `${percent(shares.first)} only in ${names[0]} (blue)`,
      `${percent(shares.second)} only in ${names[1]} (orange).`,
    ].join(", ");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Both versions from above: ${words}`);
    byId("compare-result").replaceChildren(table(chosen), el("figure", {}, canvas, el("figcaption", {}, words)));
  }
}

function table(maps) {
  const rows = [
    ["Keyframes", ({ map_keyframes: all, keyframes }) => count(all ?? keyframes)],
    ["Features", ({ features }) => count(features ?? 0)],
    ["Own frames located", ({ self_check: check }) => (check?.tried ? `${check.located} of ${check.tried}` : "not tried")],
    ["Typically off by", ({ self_check: check }) => (check?.tried ? metres(check.median_position_m ?? 0) : "not tried")],
  ];
  const head = el("tr", {}, el("td"), ...maps.map(({ version }) => el("th", { scope: "col" }, `Version ${version}`)));
  const body = rows.map(([name, figure]) => el("tr", {}, el("th", { scope: "row" }, name), ...maps.map(({ statistics }) => el("td", {}, figure(statistics)))));
  return el("table", { class: "compared" }, el("thead", {}, head), el("tbody", {}, ...body));
}

/** Draw which cells of the ground each of two sets of points has, and return the shares of all cells too. */
function overlay(first, second) {
  const [[left, right], [bottom, top]] = [0, 1].map((axis) => bounds([first, second], axis));
  const cell = Math.max(CELL_M, (right - left) / MAX_SIDE_PX, (top - bottom) / MAX_SIDE_PX);
  const [width, height] = [Math.ceil((right - left) / cell) + 1, Math.ceil((top - bottom) / cell) + 1];
  const seen = new Uint8Array(width * height);
  [first, second].forEach(({ points, count: number }, bit) => {
    for (let i = 0; i < number; i += 1) {
      const [u, v] = [Math.floor((points[3 * i] - left) / cell), Math.floor((top - points[3 * i + 1]) / cell)];
      if (u >= 0 && v >= 0 && u < width && v < height) seen[v * width + u] |= 1 << bit;
    }
  });
  const canvas = Object.assign(document.createElement("canvas"), { width, height, className: "top-view" });
  const context = canvas.getContext("2d");
  const pixels = context.createImageData(width, height);
  const total = { first: 0, second: 0, both: 0 };
  seen.forEach((bits, i) => {
    if (!bits) return;
    const kind = ["first", "second", "both"][bits - 1];
    total[kind] += 1;
    pixels.data.set([...COLOURS[kind], 255], 4 * i);
  });
  context.putImageData(pixels, 0, 0);
  const all = Math.max(1, total.first + total.second + total.both);
  return { canvas, shares: { first: total.first / all, second: total.second / all, both: total.both / all } };
}

function bounds(clouds, axis) {
  const values = Float32Array.from(clouds.flatMap(({ points, count: number }) => Array.from({ length: number }, (_, i) => points[3 * i + axis]))).sort();
  const skip = Math.floor(OUTLIER_SHARE * values.length);
  return [values[skip] ?? 0, values[values.length - 1 - skip] ?? 0];
}

const percent = (share) => `${Math.round(100 * share)} %`;
