// The ground of a plan of many pixels: only the tiles that are in view, at the zoom of the screen.

import { request } from "./api.js";
import { svg } from "./dom.js";

// Tiles that are kept beside those in view, so that moving back and forth asks for none again.
const KEPT_TILES = 60;
const AT_ONCE = 4;

export class PlanTiles {
  /** `plan` is the floor's, `where` the path of its plan. Draws into `node`, in pixels of the plan's image. */
  constructor(plan, where) {
    Object.assign(this, { where, tiles: plan.tiles, node: svg("g", { class: "plan-tiles" }) });
    this.shown = new Map();
    this.waiting = [];
    this.running = 0;
    this.closed = new AbortController();
  }

  /** Fetch what the view of a viewport needs; `view` is its middle and scale, `box` the element that it fills. */
  update({ view, box }) {
    const { tiles } = this;
    const density = window.devicePixelRatio || 1;
    const pixelsPerPx = (view.unitsPerPx * tiles.reduced_by) / density;
    const coarser = Math.max(0, Math.floor(Math.log2(Math.max(pixelsPerPx, 1))));
    const zoom = Math.max(0, tiles.max_zoom - coarser);
    const side = this.side(zoom);
    const across = (middle, length, pixels) => {
      const half = (length * view.unitsPerPx) / 2;
      const last = Math.ceil(pixels / (side * tiles.reduced_by)) - 1;
      const number = (at) => Math.min(last, Math.max(0, Math.floor((at + 0.5) / side)));
      return [number(middle - half), number(middle + half)];
    };
    const [left, right] = across(view.x, box.clientWidth, tiles.width_px);
    const [top, bottom] = across(view.y, box.clientHeight, tiles.height_px);
    // The whole plan, coarsely, is under everything.
    this.wanted = ["0/0/0"];
    for (let row = top; row <= bottom; row += 1) {
      for (let column = left; column <= right; column += 1) this.wanted.push(`${zoom}/${column}/${row}`);
    }
    this.waiting = this.wanted.filter((name) => !this.shown.has(name));
    for (const name of this.wanted.filter((each) => this.shown.has(each))) this.touch(name);
    this.next();
  }

  /** Length of a tile's side at a zoom, in pixels of the plan's image. */
  side(zoom) {
    return (this.tiles.tile_px * 2 ** (this.tiles.max_zoom - zoom)) / this.tiles.reduced_by;
  }

  touch(name) {
    const image = this.shown.get(name);
    this.shown.delete(name);
    this.shown.set(name, image);
  }

  next() {
    while (this.running < AT_ONCE && this.waiting.length) {
      const name = this.waiting.shift();
      if (this.shown.has(name)) continue;
      this.running += 1;
      this.shown.set(name, null);
      this.fetch(name)
        .catch(() => this.shown.delete(name))
        .finally(() => {
          this.running -= 1;
          this.next();
        });
    }
  }

  async fetch(name) {
    const response = await request(`${this.where}/tiles/${name}.png`, { signal: this.closed.signal });
    const url = URL.createObjectURL(await response.blob());
    if (this.closed.signal.aborted) {
      URL.revokeObjectURL(url);
      return;
    }
    const [zoom, column, row] = name.split("/").map(Number);
    const side = this.side(zoom);
    const { tiles } = this;
    const step = 2 ** (tiles.max_zoom - zoom);
    // A tile at the right or lower edge is smaller.
    const length = (pixels, number) =>
      (Math.min(tiles.tile_px, Math.ceil(pixels / step) - number * tiles.tile_px) * step) / tiles.reduced_by;
    const [width, height] = [length(tiles.width_px, column), length(tiles.height_px, row)];
    const image = svg("image", { href: url, x: column * side - 0.5, y: row * side - 0.5, width, height });
    image.dataset.zoom = String(zoom);
    // A coarser one never covers a finer one.
    const finer = [...this.node.children].find((other) => Number(other.dataset.zoom) > zoom);
    this.node.insertBefore(image, finer ?? null);
    this.shown.set(name, image);
    this.drop();
  }

  /** Forget the tiles that were in view longest ago. */
  drop() {
    const spare = [...this.shown].filter(([name, image]) => image && !this.wanted.includes(name));
    for (const [name, image] of spare.slice(0, Math.max(0, spare.length - KEPT_TILES))) {
      this.shown.delete(name);
      this.remove(image);
    }
  }

  remove(image) {
    URL.revokeObjectURL(image.getAttribute("href"));
    image.remove();
  }

  /** Free all tiles; nothing is fetched any more. */
  close() {
    this.closed.abort();
    this.waiting = [];
    for (const image of this.shown.values()) if (image) this.remove(image);
    this.shown.clear();
  }
}
