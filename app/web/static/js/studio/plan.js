// The plan image of a floor: an upload whose scale is told by two clicks and the distance between them.

import { request, requestJson } from "../api.js";
import { byId, guarded, notice, showError, svg } from "../dom.js";
import { surely } from "./saving.js";

// What browsers show by themselves, and the server stores as it is.
const SHOWN = ["image/png", "image/jpeg"];

export class PlanTool {
  constructor(board, floors, onStored) {
    Object.assign(this, { board, floors, onStored, ends: [], file: null, turn: 0, place: null });
    byId("plan-image").addEventListener("change", () => {
      byId("plan-page").value = "1";
      this.choose(byId("plan-image").files[0]);
    });
    byId("plan-page").addEventListener("change", () => this.choose(byId("plan-image").files[0]));
    byId("distance").addEventListener("input", () => this.say());
    byId("scale-again").addEventListener("click", () => this.again());
    byId("plan-panel").addEventListener("submit", (event) => {
      event.preventDefault();
      guarded(byId("save-plan"), byId("board-error"), () => surely(floors, () => this.save()));
    });
  }

  /** Begin with the shown floor: a picture that was chosen for another one is not stored as its plan. */
  begin() {
    const { place } = this.floors;
    if (this.place !== place) {
      Object.assign(this, { place, file: null, ends: [], turn: this.turn + 1 });
      byId("plan-image").value = "";
      byId("page-field").hidden = true;
    }
    if (this.file) this.board.show(this.picture);
    this.say();
  }

  /** Leave the stored plan to the other tools: what is drawn on it has its scale. */
  leave() {
    if (this.file) this.floors.draw();
  }

  /** Show a file before it is sent. One unit is one pixel until its scale is known. */
  async choose(file) {
    Object.assign(this, { file: null, ends: [], turn: this.turn + 1 });
    const { turn } = this;
    byId("page-field").hidden = !file || !/pdf|tiff/.test(file.type);
    showError(byId("board-error"), null);
    if (!file) return this.floors.showSurely(this.floors.current.id);
    const image = new Image();
    try {
      const shown = SHOWN.includes(file.type) ? file : await this.drawn(file);
      image.src = URL.createObjectURL(shown);
      await image.decode().catch(() => {
        throw new Error("The browser can't read this picture. Save it as PNG or JPEG.");
      });
      // Another file, page or floor was chosen meanwhile.
      if (turn !== this.turn) return undefined;
      const [width, height] = [image.naturalWidth, image.naturalHeight];
      const picture = { url: image.src, width, height, metersPerPixel: 1, origin: [0, 0] };
      // What was clicked until now was clicked in the picture before.
      Object.assign(this, { file: shown, picture, size: [width, height], ends: [] });
      if (this.board.tool === this) this.board.show(picture);
    } catch (error) {
      if (turn !== this.turn) return undefined;
      showError(byId("board-error"), error);
    }
    return this.draw();
  }

  /** Return the picture that the server draws of a PDF, SVG or TIFF. */
  async drawn(file) {
    const form = new FormData();
    form.set("image", file, file.name);
    form.set("page", byId("plan-page").value || "1");
    const response = await request(this.floors.path("plan", "picture"), { method: "POST", form });
    return new File([await response.blob()], `${file.name}.png`, { type: "image/png" });
  }

  again() {
    this.ends = [];
    this.draw();
  }

  key(event) {
    if (event.key !== "Escape" || !this.ends.length) return false;
    this.again();
    return true;
  }

  /** The scale is not known yet: places are pixels. */
  describe(point) {
    const [u, v] = this.board.units(point).map(Math.round);
    return `At pixel ${u}, ${v} of the plan.`;
  }

  click(point) {
    this.ends = this.ends.length === 1 ? [this.ends[0], point] : [point];
    this.draw();
  }

  /** Metres between the two clicks in the board's present frame. */
  get measured() {
    if (this.ends.length < 2) return null;
    const [[x0, y0], [x1, y1]] = this.ends;
    return Math.hypot(x1 - x0, y1 - y0) || null;
  }

  get metersPerPixel() {
    const distance = Number(byId("distance").value);
    if (!this.measured || !(distance > 0)) return null;
    return Number(((this.board.frame.metersPerUnit * distance) / this.measured).toPrecision(7));
  }

  say() {
    byId("save-plan").disabled = !this.metersPerPixel || !this.floors.current;
    if (!this.floors.current) {
      byId("scale-words").textContent = "Add a floor first.";
      return;
    }
    const scale = this.metersPerPixel;
    const [width, height] = this.size ?? [];
    const size = scale && this.size ? ` The whole plan is ${(width * scale).toFixed(1)} m by ${(height * scale).toFixed(1)} m.` : "";
    byId("scale-words").textContent = scale
      ? `${Number(scale.toPrecision(4))} m per pixel.${size}`
      : `Click the ${this.ends.length ? "second" : "first"} of two points whose distance you know.`;
  }

  draw() {
    if (this.board.tool !== this) return;
    const { plan } = this.floors.current ?? {};
    if (!this.file) this.size = plan ? [plan.width_px, plan.height_px] : null;
    const shapes = this.ends.length === 2 ? [svg("polyline", { points: this.board.line(this.ends), class: "measure" })] : [];
    this.board.glyphs = [];
    shapes.push(...this.ends.map((end) => this.board.glyph(end, svg("circle", { r: 6, class: "pin" }))));
    this.board.layer.replaceChildren(...shapes);
    this.say();
  }

  async save() {
    // Another file, page or floor may be chosen before the answers come.
    const { file, turn, place } = this;
    const { id, plan } = this.floors.current;
    const where = this.floors.path("plan");
    const form = new FormData();
    // Plan (0, 0) is the lower left corner of the image.
    const origin = plan && !file ? plan.origin_px : [0, this.size[1] - 1];
    form.set("meters_per_pixel", String(this.metersPerPixel));
    form.set("origin_px", origin.join(","));
    // The stored image again, when only its scale changes.
    const image = file ?? (await (await request(where)).blob());
    form.set("image", image, file?.name ?? "plan");
    await requestJson(where, { method: "PUT", form });
    if (turn !== this.turn || place !== this.floors.place) return;
    Object.assign(this, { file: null, ends: [] });
    byId("plan-image").value = "";
    await this.floors.load(id);
    byId("board-error").replaceChildren(notice("good", "The plan is stored."));
    this.onStored();
  }
}
