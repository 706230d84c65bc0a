// Lays the scan over the plan: by dragging, turning and scaling, then by pairs of points with their residuals.

import { byId, el, guarded, notice, svg } from "../dom.js";
import { turns } from "../turns.js";
import { currentVenue } from "../venues.js";
import { metres } from "../words.js";
import { History } from "./history.js";
import { surely } from "./saving.js";
import { ScanPoints } from "./scan-image.js";
import { apply, changedAbout, fit, fromMatrix, invert, outlier, residuals, toMatrix } from "./similarity.js";

const FIELDS = ["shift-x", "shift-y", "turn", "scale"];
// A click misses by a pixel or two of the screen: where one is more than this, pairs are worse than dragging.
const COARSE_PIXEL_M = 0.02;

export class AlignTool {
  constructor(board, floors, onStored) {
    Object.assign(this, { board, floors, onStored, mode: "move", pairs: [], half: null, similarity: null, scan: null, pictures: turns() });
    for (const button of byId("align-panel").querySelectorAll("[data-tool]")) {
      button.addEventListener("click", () => this.choose(button.dataset.tool));
    }
    for (const id of FIELDS) {
      byId(id).addEventListener("input", () => this.typed(id));
      byId(id).addEventListener("change", () => this.drop());
    }
    this.history = new History(() => this.changed());
    byId("align-undo").addEventListener("click", () => this.history.undo());
    byId("align-redo").addEventListener("click", () => this.history.redo());
    addEventListener("keydown", (event) => {
      if (!byId("align-panel").hidden && !event.target.matches("input, textarea")) this.history.shortcut(event);
    });
    for (const id of ["z-min", "z-max"]) byId(id).addEventListener("change", () => this.picture());
    byId("fit-pairs").addEventListener("click", () => {
      this.similarity = fit(this.pairs);
      this.drop();
    });
    byId("align-panel").addEventListener("submit", (event) => {
      event.preventDefault();
      guarded(byId("save-align"), byId("board-error"), () => surely(floors, () => this.save()));
    });
  }

  /** Begin with the shown floor and the map that serves; says what is missing. */
  async begin(isLatest) {
    Object.assign(this, { pairs: [], half: null, image: null, similarity: null, scan: null });
    const { current, venue } = this.floors;
    const version = currentVenue()?.map_version ?? null;
    byId("save-align").disabled = true;
    this.say(!current ? "Add a floor first." : version === null ? "Upload a scan first: there is nothing to lay over the plan yet." : "The scan is loading …");
    if (!current || version === null) return;
    const scan = await ScanPoints.of(venue, version);
    if (!isLatest()) return;
    this.scan = scan;
    byId("z-min").value = String(Number(current.z_min_m.toFixed(2)));
    byId("z-max").value = String(Number(current.z_max_m.toFixed(2)));
    this.histogram();
    await this.picture();
    if (!isLatest()) return;
    const similarity = current.plan_from_world ? fromMatrix(current.plan_from_world) : this.guess();
    const isBack = this.history.begin(`${venue}.${current.id}.align`, { similarity, pairs: [] });
    byId("save-align").disabled = false;
    this.choose("move");
    if (isBack) byId("board-error").replaceChildren(notice("info", "The alignment that you didn't save is back. Save it, or undo it."));
  }

  async picture() {
    const { scan } = this;
    if (!scan) return;
    const isLatest = this.pictures();
    const [low, high] = [Number(byId("z-min").value), Number(byId("z-max").value)];
    const image = await scan.drawn(low, high);
    // Other heights or another scan were chosen meanwhile.
    if (!isLatest() || scan !== this.scan) return;
    if (this.image) URL.revokeObjectURL(this.image.url);
    this.image = image;
    if (!this.image) byId("board-error").replaceChildren(notice("info", "The scan has no points at these heights."));
    else byId("board-error").replaceChildren();
    this.histogram();
    this.draw();
  }

  /** Lay the middle of the scan over the middle of the plan. */
  guess() {
    const { plan } = this.floors.current;
    const centre = plan ? this.board.metres([plan.width_px / 2, plan.height_px / 2]) : [0, 0];
    const [x, y] = this.centre();
    return { x: centre[0] - x, y: centre[1] - y, turn: 0, scale: 1 };
  }

  /** The middle of the scan in the world. */
  centre() {
    if (!this.image) return [0, 0];
    const { x, y, width, height, metresPerPx } = this.image;
    return [x + (width * metresPerPx) / 2, y - (height * metresPerPx) / 2];
  }

  histogram() {
    const { from, to, bins } = this.scan.heights();
    const step = 100 / bins.length;
    const [low, high] = [Number(byId("z-min").value), Number(byId("z-max").value)];
    const bars = bins.map((share, i) => {
      const z = from + ((i + 0.5) / bins.length) * (to - from);
      const inside = z >= low && z <= high;
      return svg("rect", { x: i * step, y: 30 - 30 * share, width: step * 0.9, height: 30 * share, class: inside ? "bar-in" : "bar-out" });
    });
    byId("histogram").replaceChildren(...bars);
  }

  choose(mode) {
    this.mode = mode;
    this.half = null;
    for (const button of byId("align-panel").querySelectorAll("[data-tool]")) {
      button.setAttribute("aria-pressed", String(button.dataset.tool === mode));
    }
    const words = {
      move: "Drag the scan to where it belongs.",
      turn: "Drag around the middle of the scan to turn it.",
      pair: this.pairWords(),
    };
    this.say(words[mode]);
    this.draw();
  }

  pairWords() {
    const pixel = this.board.metresPerPx;
    const closer = pixel > COARSE_PIXEL_M ? `Zoom in first: here a pixel of the screen is ${metres(pixel)}. ` : "";
    return `${closer}Click a point of the scan, then the same point of the plan. Three pairs far apart are good.`;
  }

  rescaled() {
    if (this.mode === "pair" && !this.half && !this.pairs.length) this.say(this.pairWords());
  }

  say(sentence) {
    // The same sentence again would be read out again.
    if (byId("pair-words").textContent !== sentence) byId("pair-words").textContent = sentence;
  }

  /** Take what history has: the same as before, or what was undone or done again. */
  changed() {
    const { past, future } = this.history;
    Object.assign(this, this.history.get());
    byId("align-undo").disabled = past.length === 0;
    byId("align-redo").disabled = future.length === 0;
    this.draw();
  }

  /** Keep the present state as one step. */
  drop() {
    const { similarity, pairs } = this;
    if (similarity) this.history.change((all) => Object.assign(all, { similarity, pairs }));
  }

  /** Take what was typed into one field; the others show rounded values, which must not be taken for those that are meant. */
  typed(id) {
    const { similarity } = this;
    const value = Number(byId(id).value);
    if (!similarity || (id === "scale" && !(value > 0))) return;
    // The fields say where the middle of the scan is, which stays when it is turned.
    const middle = apply(similarity, this.centre());
    const changes = {
      "shift-x": () => ({ ...similarity, x: similarity.x + value - middle[0] }),
      "shift-y": () => ({ ...similarity, y: similarity.y + value - middle[1] }),
      turn: () => changedAbout(similarity, middle, { turn: (value * Math.PI) / 180 }),
      scale: () => changedAbout(similarity, middle, { scale: value }),
    };
    this.similarity = changes[id]();
    this.draw(false);
  }

  dragStart(point) {
    if (!this.similarity || !this.image || this.mode === "pair") return false;
    this.from = { point, similarity: this.similarity, middle: apply(this.similarity, this.centre()) };
    return true;
  }

  drag([x, y]) {
    const { point, similarity, middle } = this.from;
    if (this.mode === "move") {
      this.similarity = { ...similarity, x: similarity.x + x - point[0], y: similarity.y + y - point[1] };
    } else {
      const angle = (at) => Math.atan2(at[1] - middle[1], at[0] - middle[0]);
      this.similarity = changedAbout(similarity, middle, { turn: similarity.turn + angle([x, y]) - angle(point) });
    }
    this.draw();
  }

  /** Put the scan back to where it was before the drag. */
  cancelDrag() {
    this.similarity = this.from.similarity;
    this.draw();
  }

  key(event) {
    if (event.key !== "Escape" || !this.half) return false;
    this.choose("pair");
    return true;
  }

  click(point) {
    if (this.mode !== "pair" || !this.similarity) return;
    if (!this.half) {
      this.half = { world: invert(this.similarity, point) };
      this.say("Now click the same point of the plan.");
    } else {
      this.pairs.push({ ...this.half, plan: point });
      this.half = null;
      this.drop();
      this.say(`${this.pairs.length} pairs. ${this.pairs.length < 3 ? "Click the next point of the scan." : "Fit to the pairs, or add more."}`);
    }
    this.draw();
  }

  draw(fields = true) {
    const { board } = this;
    if (board.tool !== this) return;
    board.glyphs = [];
    board.layer.replaceChildren();
    if (!this.similarity) return;
    if (this.image) board.layer.append(this.overlay());
    for (const [i, pair] of this.pairs.entries()) {
      const here = apply(this.similarity, pair.world);
      board.layer.append(
        svg("polyline", { points: board.line([here, pair.plan]), class: "pair-line" }),
        board.glyph(here, svg("circle", { r: 6, class: "pin-scan" })),
        board.glyph(pair.plan, svg("circle", { r: 6, class: "pin" }), svg("text", { x: 9, y: 5 }, String(i + 1))),
      );
    }
    if (this.half) board.layer.append(board.glyph(apply(this.similarity, this.half.world), svg("circle", { r: 6, class: "pin-scan" })));
    if (fields) this.showFields();
    this.list();
  }

  overlay() {
    const { x, y, width, height, metresPerPx, url } = this.image;
    const at = (u, v) => this.board.units(apply(this.similarity, [x + u * metresPerPx, y - v * metresPerPx]));
    const [[ox, oy], [rx, ry], [dx, dy]] = [at(0, 0), at(1, 0), at(0, 1)];
    const transform = `matrix(${rx - ox} ${ry - oy} ${dx - ox} ${dy - oy} ${ox} ${oy})`;
    return svg("image", { href: url, width, height, transform, class: "scan" });
  }

  showFields() {
    const { turn, scale } = this.similarity;
    const [x, y] = apply(this.similarity, this.centre());
    const degrees = (turn * 180) / Math.PI;
    const values = [x.toFixed(2), y.toFixed(2), degrees.toFixed(1), scale.toFixed(3)];
    FIELDS.forEach((id, i) => {
      byId(id).value = String(Number(values[i]));
    });
  }

  list() {
    const off = residuals(this.similarity, this.pairs);
    const wrong = outlier(this.pairs);
    byId("fit-pairs").disabled = this.pairs.length < 2;
    byId("pairs").replaceChildren(
      ...this.pairs.map((_, i) => {
        const remove = el("button", { type: "button", class: "small", "aria-label": `Remove pair ${i + 1}` }, "Remove");
        remove.addEventListener("click", () => {
          this.pairs.splice(i, 1);
          this.drop();
          // The list is drawn anew: the keyboard keeps its place in it.
          const rest = byId("pairs").querySelectorAll("button");
          (rest[i] ?? rest[i - 1] ?? byId("align-panel").querySelector("[data-tool=pair]")).focus();
        });
        const words = i === wrong ? `${metres(off[i])} off: this pair contradicts the others` : `${metres(off[i])} off`;
        return el("li", { class: i === wrong ? "wrong" : null }, `${words} `, remove);
      }),
    );
  }

  async save() {
    const heights = { z_min_m: Number(byId("z-min").value), z_max_m: Number(byId("z-max").value) };
    const z = this.floors.current.plan_from_world?.[2][3] ?? 0;
    if (!this.similarity) throw new Error("The scan is not loaded yet.");
    const before = this.history.mark();
    const { similarity, pairs } = this;
    const off = residuals(similarity, pairs);
    await this.floors.put({ ...heights, plan_from_world: toMatrix(similarity, z) });
    const rms = off.length ? ` The pairs are ${metres(Math.sqrt(off.reduce((sum, value) => sum + value * value, 0) / off.length))} off.` : "";
    // What was moved while this was on its way stays unsaved.
    this.history.storedAt(before, { similarity, pairs });
    byId("board-error").replaceChildren(notice("good", `The alignment is stored.${rms}`));
    this.onStored();
  }
}
