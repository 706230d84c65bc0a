// The board: a floor's plan that tools draw on, with pointer and keyboard alike. Coordinates are plan metres.

import { byId, svg } from "../dom.js";
import { Viewport } from "../viewport.js";
import { placeLabels } from "./labels.js";

// Metres of a unit where there is no plan image.
const GRID_M = 0.02;
// A press that moves less than this is a click.
const CLICK_PX = 5;
const CROSS_STEP_PX = 16;

export class Board {
  constructor() {
    this.svg = byId("board-svg");
    this.box = byId("board");
    this.ground = svg("g");
    this.layer = svg("g");
    this.cross = svg("path", { class: "cross", visibility: "hidden" });
    this.svg.append(this.ground, this.layer, this.cross);
    this.viewport = new Viewport(this.svg, this.box, () => this.rescaled());
    this.frame = { metersPerUnit: GRID_M, origin: [0, 0] };
    this.tool = null;
    this.crossAt = null;
    this.glyphs = [];
    this.labelling = null;
    new MutationObserver(() => this.label()).observe(this.layer, { childList: true });
    // Before the viewport's own listeners, which move the plan.
    this.box.addEventListener("pointerdown", (event) => this.press(event), true);
    this.box.addEventListener("pointermove", (event) => this.pull(event), true);
    this.box.addEventListener("pointerup", (event) => this.release(event), true);
    this.box.addEventListener("keydown", (event) => this.key(event), true);
    this.box.addEventListener("blur", () => this.cross.setAttribute("visibility", "hidden"));
  }

  /** Show an image in this frame: `{url, width, height, metersPerPixel, origin}`, or with `tiles` for `url`; null
   * shows empty ground. */
  show(image) {
    this.frame = image ? { metersPerUnit: image.metersPerPixel, origin: image.origin } : { metersPerUnit: GRID_M, origin: [0, 0] };
    this.ground.replaceChildren();
    this.layer.replaceChildren();
    this.crossAt = null;
    if (image) {
      const size = { x: -0.5, y: -0.5, width: image.width, height: image.height };
      this.ground.append(image.tiles ? image.tiles.node : svg("image", { href: image.url, ...size }));
      this.viewport.setContent(size, image.tiles);
    } else {
      this.viewport.setContent({ x: -1000, y: -1000, width: 2000, height: 2000 });
    }
  }

  /** Use a tool: it may have `click(xy, event)`, `dragStart(xy)` that returns whether it takes the drag, and `drag(xy)`. */
  use(tool) {
    this.tool?.leave?.();
    this.tool = tool;
    this.layer.replaceChildren();
    this.glyphs = [];
    tool?.draw?.();
  }

  /** Return the unit coordinates of a point of the plan, metres. */
  units([x, y]) {
    const { metersPerUnit, origin } = this.frame;
    return [origin[0] + x / metersPerUnit, origin[1] - y / metersPerUnit];
  }

  /** Return plan metres of unit coordinates. */
  metres([u, v]) {
    const { metersPerUnit, origin } = this.frame;
    return [(u - origin[0]) * metersPerUnit, (origin[1] - v) * metersPerUnit];
  }

  /** Return how many metres a pixel of the screen is. */
  get metresPerPx() {
    return this.viewport.unitsPerPx * this.frame.metersPerUnit;
  }

  line(points) {
    return points.map((point) => this.units(point).join(",")).join(" ");
  }

  /** Return an element that keeps its size on the screen, at a point in metres. */
  glyph(point, ...children) {
    const node = svg("g", {}, ...children);
    this.glyphs.push({ node, point });
    this.place(node, point);
    return node;
  }

  rescaled() {
    for (const { node, point } of this.glyphs ?? []) this.place(node, point);
    if (this.crossAt) this.drawCross();
    this.label();
    this.tool?.rescaled?.();
  }

  /** Make room between names, once for all that changes before the next picture. */
  label() {
    this.labelling ??= requestAnimationFrame(() => {
      this.labelling = null;
      placeLabels(this.layer, this.box);
    });
  }

  place(node, point) {
    const [u, v] = this.units(point);
    node.setAttribute("transform", `translate(${u} ${v}) scale(${this.viewport.unitsPerPx})`);
  }

  at(event) {
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(this.svg.getScreenCTM().inverse());
    return this.metres([x, y]);
  }

  press(event) {
    if (event.button !== 0) return;
    this.pressed = { x: event.clientX, y: event.clientY, moved: false };
    const at = this.at(event);
    this.taken = this.tool?.dragStart?.(at, event) ?? false;
    if (!this.taken) return;
    this.box.setPointerCapture(event.pointerId);
    event.stopPropagation();
  }

  pull(event) {
    if (!this.pressed) return;
    if (Math.hypot(event.clientX - this.pressed.x, event.clientY - this.pressed.y) > CLICK_PX) this.pressed.moved = true;
    if (!this.taken) return;
    event.stopPropagation();
    if (this.pressed.moved) this.tool.drag(this.at(event));
  }

  release(event) {
    const { pressed } = this;
    this.pressed = null;
    if (!pressed) return;
    if (this.taken) {
      event.stopPropagation();
      this.viewport.pointers.delete(event.pointerId);
    }
    if (!pressed.moved) this.tool?.click?.(this.at(event), event);
    else if (this.taken) this.tool.drop?.();
    this.taken = false;
  }

  key(event) {
    if (event.target !== this.box || !this.tool?.click) return;
    const step = (event.shiftKey ? 5 : 1) * CROSS_STEP_PX * this.viewport.unitsPerPx;
    const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    const move = moves[event.key];
    if (move) {
      this.crossAt ??= [this.viewport.view.x, this.viewport.view.y];
      this.crossAt = this.crossAt.map((value, i) => value + move[i]);
      this.viewport.reveal(...this.crossAt);
      this.viewport.setFocus(this.crossAt);
      this.drawCross();
    } else if (event.key === "Enter" && this.crossAt) {
      this.tool.click(this.metres(this.crossAt), event);
    } else if (!this.tool.key?.(event)) {
      return;
    }
    event.preventDefault();
    event.stopPropagation();
  }

  drawCross() {
    const [u, v] = this.crossAt;
    const arm = 14 * this.viewport.unitsPerPx;
    this.cross.setAttribute("d", `M ${u - arm} ${v} H ${u + arm} M ${u} ${v - arm} V ${v + arm}`);
    this.cross.setAttribute("visibility", "visible");
  }
}
