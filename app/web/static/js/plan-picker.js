// Reads origin and scale of a plan image off the image itself: one click for the origin, two for a distance.

import { byId, svg } from "./dom.js";
import { turns } from "./turns.js";

export class PlanPicker {
  constructor() {
    this.svg = byId("plan-pick-svg");
    this.image = null;
    this.turn = turns();
    this.ends = [];
    byId("plan-image").addEventListener("change", (event) => this.load(event.target.files[0]));
    this.svg.addEventListener("click", (event) => this.pick(event));
    byId("distance").addEventListener("input", () => this.measure());
    byId("origin").addEventListener("input", () => this.draw());
    for (const radio of document.getElementsByName("plan-tool")) {
      radio.addEventListener("change", () => {
        byId("measure-field").hidden = this.tool !== "measure";
      });
    }
  }

  get tool() {
    return document.querySelector('input[name="plan-tool"]:checked').value;
  }

  clear() {
    if (this.image) URL.revokeObjectURL(this.image.src);
    this.image = null;
    this.ends = [];
    byId("plan-tools").hidden = true;
    byId("measure-field").hidden = true;
  }

  async load(file) {
    this.clear();
    const isLatest = this.turn();
    if (!file) return;
    const image = new Image();
    image.src = URL.createObjectURL(file);
    try {
      await image.decode();
    } catch {
      // Not an image: the server's answer will say so in words.
      return;
    }
    // Another file was chosen meanwhile.
    if (!isLatest()) {
      URL.revokeObjectURL(image.src);
      return;
    }
    this.image = image;
    byId("plan-tools").hidden = false;
    this.draw();
  }

  pick(event) {
    // The middle of the first pixel is (0, 0), its corner (-0.5, -0.5).
    const inverse = this.svg.getScreenCTM().inverse();
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(inverse);
    if (this.tool === "origin") {
      byId("origin").value = `${x.toFixed(1)}, ${y.toFixed(1)}`;
    } else {
      this.ends = this.ends.length === 1 ? [this.ends[0], [x, y]] : [[x, y]];
      this.measure();
    }
    this.draw();
  }

  measure() {
    const distance = Number(byId("distance").value);
    if (this.ends.length < 2 || !(distance > 0)) return;
    const [[x0, y0], [x1, y1]] = this.ends;
    const pixels = Math.hypot(x1 - x0, y1 - y0);
    if (pixels > 0) byId("meters-per-pixel").value = String(Number((distance / pixels).toPrecision(6)));
  }

  draw() {
    if (!this.image) return;
    const { naturalWidth: width, naturalHeight: height, src } = this.image;
    const unit = Math.max(width, height) / 100;
    this.svg.setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
    const shapes = [svg("image", { href: src, x: -0.5, y: -0.5, width, height })];
    const [u, v] = byId("origin").value.split(",").map(Number);
    if (byId("origin").value.trim() && Number.isFinite(u) && Number.isFinite(v)) {
      const arm = 8 * unit;
      shapes.push(svg("path", { d: `M ${u} ${v - arm} V ${v} H ${u + arm}`, class: "pick-axes" }));
      shapes.push(svg("circle", { cx: u, cy: v, r: 1.2 * unit, class: "pick-point" }));
    }
    if (this.ends.length === 2) {
      shapes.push(svg("polyline", { points: this.ends.map((end) => end.join(",")).join(" "), class: "pick-line" }));
    }
    for (const [x, y] of this.ends) shapes.push(svg("circle", { cx: x, cy: y, r: 1.2 * unit, class: "pick-end" }));
    this.svg.replaceChildren(...shapes);
  }
}
