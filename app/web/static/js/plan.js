// Draws one floor: its plan image or a grid of metres, and on it the places of photos.

import { byId, svg } from "./dom.js";
import { Viewport } from "./viewport.js";
import { metres } from "./words.js";

const GRID_M_PER_UNIT = 0.01;
const BEAM_PX = 64;

export class PlanDrawing {
  /** `onSelect` gets the number of a mark that was clicked. */
  constructor(onSelect) {
    this.svg = byId("plan-svg");
    this.onSelect = onSelect;
    this.ground = svg("g");
    this.marks = svg("g");
    this.svg.append(this.ground, this.marks);
    this.frame = gridFrame();
    this.glyphs = [];
    this.viewport = new Viewport(this.svg, byId("plan"), (unitsPerPx) => this.rescale(unitsPerPx));
    byId("zoom-in").addEventListener("click", () => this.viewport.zoom(1.5));
    byId("zoom-out").addEventListener("click", () => this.viewport.zoom(1 / 1.5));
    byId("zoom-fit").addEventListener("click", () => this.viewport.fit());
  }

  /** Show a plan image; `plan` is the floor's, `url` that of the image, `tiles` what a large plan has in its place. */
  showPlan(plan, url, tiles = null) {
    this.frame = { metersPerUnit: plan.meters_per_pixel, origin: plan.origin_px, grid: false };
    const size = { x: -0.5, y: -0.5, width: plan.width_px, height: plan.height_px };
    this.ground.replaceChildren(tiles ? tiles.node : svg("image", { href: url, ...size }));
    this.viewport.setContent(size, tiles);
  }

  /** Show a grid of metres in place of an image. */
  showGrid() {
    this.frame = gridFrame();
    const cell = 1 / GRID_M_PER_UNIT;
    const lines = svg("path", { d: `M ${cell} 0 H 0 V ${cell}`, class: "grid-line" });
    const pattern = svg("pattern", { id: "metre", width: cell, height: cell, patternUnits: "userSpaceOnUse" }, lines);
    const size = 400 * cell;
    const area = svg("rect", { x: -size / 2, y: -size / 2, width: size, height: size, fill: "url(#metre)" });
    const axes = svg("path", { d: `M 0 ${-cell} V 0 H ${cell}`, class: "grid-axes" });
    this.ground.replaceChildren(svg("defs", {}, pattern), area, axes);
    this.viewport.setContent(around([], cell));
  }

  /** Draw the places: `{number, x, y, headingDeg, accuracyM, fovDeg, label}` in metres, in order. */
  showPlaces(places, selected) {
    const points = places.map((place) => this.point(place.x, place.y));
    const path = svg("polyline", { points: points.map(([u, v]) => `${u},${v}`).join(" "), class: "trail-line" });
    const ordered = places.map((place, i) => [place, points[i]]);
    // The chosen one is drawn last, on top of all others.
    ordered.sort(([a], [b]) => Number(a.number === selected) - Number(b.number === selected));
    this.glyphs = ordered.map(([place, point]) => this.mark(place, point, place.number === selected));
    this.marks.replaceChildren(...(points.length > 1 ? [path] : []), ...this.glyphs.map((glyph) => glyph.node));
    if (this.frame.grid) this.viewport.setContent(around(points, 1 / GRID_M_PER_UNIT));
    this.rescale(this.viewport.unitsPerPx);
    const chosen = places.findIndex((place) => place.number === selected);
    this.viewport.setFocus(points[chosen] ?? null);
    if (chosen >= 0) this.viewport.reveal(...points[chosen]);
  }

  point(x, y) {
    const { metersPerUnit, origin } = this.frame;
    return [origin[0] + x / metersPerUnit, origin[1] - y / metersPerUnit];
  }

  mark(place, [u, v], isSelected) {
    const turn = svg("g", { transform: `rotate(${-place.headingDeg})` });
    if (isSelected) turn.append(svg("path", { d: beam(place.fovDeg), class: "beam" }));
    turn.append(svg("path", { d: isSelected ? "M 19 0 L 8 -7.5 V 7.5 Z" : "M 13 0 L 6 -4.5 V 4.5 Z", class: "arrow" }));
    const glyph = svg("g", {}, turn, svg("circle", { r: isSelected ? 8.5 : 6, class: "dot" }));
    const radius = place.accuracyM / this.frame.metersPerUnit;
    const halo = svg("circle", { cx: u, cy: v, r: radius, class: "halo" });
    const node = svg("g", { class: isSelected ? "mark selected" : "mark" }, halo, glyph);
    node.append(svg("title", {}, place.label));
    node.addEventListener("click", () => this.onSelect(place.number));
    return { node, glyph, u, v };
  }

  // Marks keep their size on the screen; the circle of accuracy keeps its size in metres.
  rescale(unitsPerPx) {
    for (const { glyph, u, v } of this.glyphs ?? []) {
      glyph.setAttribute("transform", `translate(${u} ${v}) scale(${unitsPerPx})`);
    }
    const metersPerPx = unitsPerPx * this.frame.metersPerUnit;
    const length = roundLength(130 * metersPerPx);
    const bar = byId("scale-bar");
    bar.querySelector("i").style.width = `${length / metersPerPx}px`;
    bar.querySelector("span").textContent = length < 1 ? metres(length) : `${length} m`;
  }
}

function gridFrame() {
  return { metersPerUnit: GRID_M_PER_UNIT, origin: [0, 0], grid: true };
}

function around(points, margin) {
  const us = points.map(([u]) => u);
  const vs = points.map(([, v]) => v);
  const [left, right] = [Math.min(0, ...us) - 2 * margin, Math.max(0, ...us) + 2 * margin];
  const [top, bottom] = [Math.min(0, ...vs) - 2 * margin, Math.max(0, ...vs) + 2 * margin];
  return { x: left, y: top, width: right - left, height: bottom - top };
}

function beam(fovDeg) {
  const half = ((fovDeg ?? 60) * Math.PI) / 360;
  const [x, y] = [BEAM_PX * Math.cos(half), BEAM_PX * Math.sin(half)];
  return `M 0 0 L ${x} ${-y} A ${BEAM_PX} ${BEAM_PX} 0 0 1 ${x} ${y} Z`;
}

function roundLength(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return Number(([5, 2, 1].find((step) => step * power <= most) * power).toPrecision(1));
}
