// Zooming and moving of an SVG through its viewBox: wheel, pinch, drag, keys.

const MAX_ZOOM = 40;

export class Viewport {
  /** `box` is the element that takes pointers and keys; `onChange` runs after each move. */
  constructor(svgNode, box, onChange) {
    this.svg = svgNode;
    this.box = box;
    this.onChange = onChange;
    this.content = { x: 0, y: 0, width: 100, height: 100 };
    this.view = { x: 50, y: 50, unitsPerPx: 1 };
    this.tiles = null;
    this.following = true;
    this.focus = null;
    this.pointers = new Map();
    this.listen();
    new ResizeObserver(() => (this.following ? this.fit() : this.apply())).observe(box);
  }

  /** Show this rectangle, given in the SVG's units; `tiles` follow the view where the plan has them. */
  setContent(content, tiles = null) {
    if (this.tiles !== tiles) this.tiles?.close();
    this.tiles = tiles;
    this.content = content;
    this.fit();
  }

  fit() {
    const { x, y, width, height } = this.content;
    this.following = true;
    this.view = { x: x + width / 2, y: y + height / 2, unitsPerPx: this.fitUnits() };
    this.apply();
  }

  /** Zoom by a factor around a point of the screen; without one around the focus, or else the middle. */
  zoom(factor, clientX = null, clientY = null) {
    const bounds = this.box.getBoundingClientRect();
    let [dx, dy] = [clientX - bounds.left - bounds.width / 2, clientY - bounds.top - bounds.height / 2];
    if (clientX === null) [dx, dy] = this.focusOffset();
    const before = this.view.unitsPerPx;
    const fit = this.fitUnits();
    const after = Math.min(2 * fit, Math.max(fit / MAX_ZOOM, before / factor));
    this.following = false;
    this.view = {
      x: this.view.x + dx * (before - after),
      y: this.view.y + dy * (before - after),
      unitsPerPx: after,
    };
    this.apply();
  }

  move(dxPx, dyPx) {
    this.following = false;
    this.view.x -= dxPx * this.view.unitsPerPx;
    this.view.y -= dyPx * this.view.unitsPerPx;
    this.apply();
  }

  /** Keep this point where it is when keys or buttons zoom; null stands for the middle. */
  setFocus(point) {
    this.focus = point;
  }

  focusOffset() {
    if (this.focus === null) return [0, 0];
    const dx = (this.focus[0] - this.view.x) / this.view.unitsPerPx;
    const dy = (this.focus[1] - this.view.y) / this.view.unitsPerPx;
    const inside = Math.abs(dx) < this.box.clientWidth / 2 && Math.abs(dy) < this.box.clientHeight / 2;
    return inside ? [dx, dy] : [0, 0];
  }

  /** Move so that this point is in view; nothing happens when it is already. */
  reveal(x, y) {
    const { clientWidth, clientHeight } = this.box;
    const offX = Math.abs(x - this.view.x) / this.view.unitsPerPx;
    const offY = Math.abs(y - this.view.y) / this.view.unitsPerPx;
    if (offX < clientWidth / 2 - 30 && offY < clientHeight / 2 - 30) return;
    this.following = false;
    this.view = { ...this.view, x, y };
    this.apply();
  }

  get unitsPerPx() {
    return this.view.unitsPerPx;
  }

  fitUnits() {
    const { clientWidth, clientHeight } = this.box;
    return Math.max(this.content.width / Math.max(clientWidth, 1), this.content.height / Math.max(clientHeight, 1));
  }

  apply() {
    const { x, y, unitsPerPx } = this.view;
    const width = Math.max(this.box.clientWidth, 1) * unitsPerPx;
    const height = Math.max(this.box.clientHeight, 1) * unitsPerPx;
    this.svg.setAttribute("viewBox", `${x - width / 2} ${y - height / 2} ${width} ${height}`);
    this.tiles?.update(this);
    this.onChange(unitsPerPx);
  }

  listen() {
    const { box } = this;
    box.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.zoom(Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.05 : 0.0015)), event.clientX, event.clientY);
      },
      { passive: false },
    );
    box.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      this.pointers.set(event.pointerId, event);
    });
    box.addEventListener("pointermove", (event) => this.drag(event));
    for (const end of ["pointerup", "pointercancel", "pointerleave"]) {
      box.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
    }
    box.addEventListener("keydown", (event) => this.key(event));
  }

  drag(event) {
    const last = this.pointers.get(event.pointerId);
    if (!last) return;
    const other = [...this.pointers.values()].find((pointer) => pointer.pointerId !== event.pointerId);
    if (other) {
      const gap = (a) => Math.hypot(a.clientX - other.clientX, a.clientY - other.clientY);
      const middle = [(event.clientX + other.clientX) / 2, (event.clientY + other.clientY) / 2];
      if (gap(last) > 0) this.zoom(gap(event) / gap(last), ...middle);
    } else {
      this.move(event.clientX - last.clientX, event.clientY - last.clientY);
    }
    this.pointers.set(event.pointerId, event);
  }

  key(event) {
    if (event.target !== this.box) return;
    const step = 60;
    const actions = {
      ArrowLeft: () => this.move(step, 0),
      ArrowRight: () => this.move(-step, 0),
      ArrowUp: () => this.move(0, step),
      ArrowDown: () => this.move(0, -step),
      "+": () => this.zoom(1.4),
      "=": () => this.zoom(1.4),
      "-": () => this.zoom(1 / 1.4),
      0: () => this.fit(),
    };
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }
}
