// The board: a floor's plan that tools draw on, with pointer and keyboard alike. Coordinates are plan metres.

import { byId, svg } from "../dom.js";
import { Viewport } from "../viewport.js";
import { Cross } from "./cross.js";
import { placeLabels } from "./labels.js";

// Metres of a unit where there is no plan image.
const GRID_M = 0.02;
// A press that moves less than this is a click.
const CLICK_PX = 5;

export class Board {
  constructor() {
    this.svg = byId("board-svg");
    this.box = byId("board");
    this.ground = svg("g");
    this.layer = svg("g");
    this.cross = new Cross(this.box, byId("board-says"), {
      unitsPerPx: () => this.viewport.unitsPerPx,
      middle: () => (this.tool?.click ? [this.viewport.view.x, this.viewport.view.y] : null),
      limit: (point) => point,
      describe: (point) => this.describe(this.metres(point)),
    });
    this.svg.append(this.ground, this.layer, this.cross.node);
    this.viewport = new Viewport(this.svg, this.box, () => this.rescaled());
    this.frame = { metersPerUnit: GRID_M, origin: [0, 0] };
    this.tool = null;
    // Whether the keyboard holds what the cross took hold of.
    this.held = false;
    // What had the keyboard before the plan.
    this.before = null;
    this.glyphs = [];
    this.labelling = null;
    new MutationObserver(() => this.label()).observe(this.layer, { childList: true });
    // Before the viewport's own listeners, which move the plan.
    this.box.addEventListener("pointerdown", (event) => this.press(event), true);
    this.box.addEventListener("pointermove", (event) => this.pull(event), true);
    this.box.addEventListener("pointerup", (event) => this.release(event), true);
    this.box.addEventListener("keydown", (event) => this.key(event), true);
    this.box.addEventListener("focus", (event) => {
      this.before = event.relatedTarget ?? this.before;
    });
    this.box.addEventListener("blur", () => this.letGo());
  }

  /** Show an image in this frame: `{url, width, height, metersPerPixel, origin}`, or with `tiles` for `url`; null
   * shows empty ground. */
  show(image) {
    this.frame = image ? { metersPerUnit: image.metersPerPixel, origin: image.origin } : { metersPerUnit: GRID_M, origin: [0, 0] };
    this.ground.replaceChildren();
    this.layer.replaceChildren();
    this.cross.forget();
    if (image) {
      const size = { x: -0.5, y: -0.5, width: image.width, height: image.height };
      this.ground.append(image.tiles ? image.tiles.node : svg("image", { href: image.url, ...size }));
      this.viewport.setContent(size, image.tiles);
    } else {
      this.viewport.setContent({ x: -1000, y: -1000, width: 2000, height: 2000 });
    }
  }

  /** Use a tool: it may have `click(xy, event)`; `dragStart(xy)` that returns whether it takes the drag, then `drag(xy)` and
   * in the end `drop()` or `cancelDrag()`; `key(event)` that returns whether it took a key; `describe(xy)` for the cross. */
  use(tool) {
    this.tool?.leave?.();
    this.tool = tool;
    this.held = false;
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
    if (this.cross.at && document.activeElement === this.box) this.cross.begin();
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
    if (this.cross.move(event)) this.crossMoved();
    else if (event.key === "Enter" && this.held) this.letGo();
    else if (event.key === "Enter") this.clickCross(event);
    else if (event.key === " ") this.hold();
    else if (event.key === "Escape") this.escape(event);
    else if (!this.tool.key?.(event)) return;
    event.preventDefault();
    event.stopPropagation();
  }

  crossMoved() {
    const { at } = this.cross;
    this.viewport.reveal(...at);
    this.viewport.setFocus(at);
    if (this.held) this.tool.drag(this.metres(at));
  }

  clickCross(event) {
    const point = this.metres(this.cross.begin());
    this.tool.click(point, event);
    // The tool may have moved the keyboard on, such as to the name of what is new.
    if (document.activeElement === this.box) this.cross.say(`Clicked. ${this.describe(point)}`);
  }

  /** Take hold of what lies under the cross, as a pressed mouse does; or let it go. */
  hold() {
    if (this.held) return this.letGo();
    this.held = this.tool.dragStart?.(this.metres(this.cross.begin())) ?? false;
    return this.cross.say(this.held ? "Held: arrow keys move it, Space lets it go, Escape puts it back." : "There is nothing to take hold of here.");
  }

  letGo() {
    if (!this.held) return;
    this.held = false;
    this.tool.drop?.();
    this.cross.say(`Let go. ${this.describe(this.metres(this.cross.at))}`);
  }

  /** Put back what is held, or drop what was begun, or else go back to the tools. */
  escape(event) {
    if (this.held) {
      this.held = false;
      this.tool.cancelDrag?.();
      this.cross.say("Put back.");
    } else if (!this.tool.key?.(event)) {
      this.leave();
    }
  }

  /** Give the keyboard to the tool that is chosen; where there are none, to what had it before the plan. */
  leave() {
    const tools = document.querySelectorAll('[data-tool][aria-pressed="true"]');
    [...tools, this.before].find((node) => node?.checkVisibility())?.focus();
  }

  /** Return words for where the cross is. */
  describe(point) {
    const [x, y] = point.map((value) => value.toFixed(2));
    return this.tool?.describe?.(point) ?? `At ${x}, ${y} m.`;
  }
}
