// Monitoring cameras: placed by a click, with the places that they see; lens and pose are found by the map. With undo,
// redo and a draft.

import { path, request, requestJson } from "../api.js";
import { byId, el, guarded, notice, svg } from "../dom.js";
import { turns } from "../turns.js";
import { reasonWords } from "../words.js";
import { bodyOf, EMPTY, formOf, intrinsicsText, placeOf } from "./camera-form.js";
import { CameraList } from "./camera-list.js";
import { CameraPicture } from "./camera-picture.js";
import { History } from "./history.js";
import { surely } from "./saving.js";

const FIELDS = {
  id: "camera-id", x: "camera-x", y: "camera-y", height: "camera-height", intrinsics: "camera-intrinsics", name: "poi-name", region: "region", distance: "poi-distance",
};
// How often ages and pictures are read again.
const EVERY_MS = 10_000;
const WORDS = { camera: "Click where the camera hangs.", poi: "Click where the place is that the camera sees." };

export class CameraTool {
  constructor(board, floors, onStored) {
    Object.assign(this, { board, floors, onStored, mode: "camera", anchors: [], timer: null, lists: turns() });
    this.history = new History(() => this.changed());
    this.picture = new CameraPicture((region) => this.change({ region }));
    this.cameras = new CameraList({
      Edit: (anchor) => this.edit(formOf(anchor)),
      "Find it in the map": (anchor, button) => guarded(button, byId("board-error"), () => this.calibrate(anchor)),
      Delete: (anchor, button) => this.remove(anchor, button),
    });
    for (const button of byId("camera-panel").querySelectorAll("[data-tool]")) {
      button.addEventListener("click", () => this.choose(button.dataset.tool));
    }
    for (const [name, id] of Object.entries(FIELDS)) {
      byId(id).addEventListener("input", () => this.change({ [name]: byId(id).value.trim() }, name));
    }
    byId("camera-keep").addEventListener("change", () => this.change({ keep: byId("camera-keep").checked }));
    byId("camera-undo").addEventListener("click", () => this.history.undo());
    byId("camera-redo").addEventListener("click", () => this.history.redo());
    byId("new-camera").addEventListener("click", () => this.edit(EMPTY));
    addEventListener("keydown", (event) => {
      if (!byId("camera-panel").hidden && !event.target.matches("input, textarea")) this.history.shortcut(event);
    });
    byId("add-poi").addEventListener("click", (event) => guarded(event.target, byId("board-error"), () => this.addPoi()));
    byId("find-lens").addEventListener("click", (event) => guarded(event.target, byId("board-error"), () => this.findLens()));
    byId("camera-panel").addEventListener("submit", (event) => {
      event.preventDefault();
      guarded(byId("save-camera"), byId("board-error"), () => this.saveSurely());
    });
  }

  async begin(isLatest) {
    this.leave();
    const { current, venue } = this.floors;
    this.anchors = [];
    if (!current) return this.cameras.show([]);
    const key = `${venue}.${current.id}.camera`;
    const isBack = this.history.begin(key, EMPTY);
    this.picture.clear();
    this.choose("camera");
    if (isBack) byId("board-error").replaceChildren(notice("info", "The camera that you didn't save is back. Save it, or undo it."));
    await this.refresh();
    return this.again(isLatest);
  }

  /** Read again after a while, one answer after the other, until another view or floor is shown. */
  again(isLatest) {
    if (!isLatest()) return;
    this.timer = setTimeout(async () => {
      await this.refresh().catch(() => {});
      this.again(isLatest);
    }, EVERY_MS);
  }

  leave() {
    clearTimeout(this.timer);
  }

  /** Read the floor's cameras, with the newest picture of the one in the form. */
  async refresh() {
    const { current, venue } = this.floors;
    if (!current) return;
    const isLatest = this.lists();
    const all = await requestJson(`anchors?venue=${encodeURIComponent(venue)}`);
    if (this.floors.current !== current || !isLatest()) return;
    this.anchors = all.filter((anchor) => anchor.floor === current.id);
    this.cameras.show(this.anchors);
    this.draw();
    const shown = this.anchors.find((anchor) => anchor.id === this.form.id);
    if (shown) await this.picture.live(shown);
  }

  get form() {
    return this.history.value === null ? EMPTY : this.history.get();
  }

  change(values, field = null) {
    this.history.change((form) => Object.assign(form, values), field);
  }

  choose(mode) {
    this.mode = mode;
    for (const button of byId("camera-panel").querySelectorAll("[data-tool]")) {
      button.setAttribute("aria-pressed", String(button.dataset.tool === mode));
    }
    byId("camera-words").textContent = WORDS[mode];
  }

  /** Put a camera into the form; what is there and not saved can be brought back by undo. */
  edit(form) {
    this.picture.clear();
    if (this.history.dirty) this.change(form);
    else this.history.stored(form);
    this.choose("camera");
    const shown = this.anchors.find((anchor) => anchor.id === form.id);
    if (shown) guarded(byId("new-camera"), byId("board-error"), () => this.picture.live(shown));
    byId("camera-id").focus();
  }

  click(point) {
    const [x, y] = point.map((value) => Number(value.toFixed(2)));
    const form = this.form;
    const values = this.mode === "camera" ? { x: String(x), y: String(y) } : { place: [x, y] };
    const next = { ...form, ...values };
    if (next.place && next.x !== "" && next.y !== "") {
      values.distance = Math.hypot(next.x - next.place[0], next.y - next.place[1]).toFixed(2);
    }
    this.change(values);
  }

  addPoi() {
    const form = this.form;
    const poi = placeOf(form);
    const others = form.pois.filter((each) => each.id !== poi.id);
    this.change({ pois: [...others, poi], place: null, name: "", region: "", distance: "" });
  }

  /** Locate the camera's picture without intrinsics; the answer says which ones fit, and where the camera hangs. */
  async findLens() {
    const { blob } = this.picture;
    if (!blob) throw new Error("Choose a picture from the camera first.");
    const body = new FormData();
    const { current, venue } = this.floors;
    body.set("venue", venue);
    body.set("image", blob, "picture");
    const answer = await requestJson("locate", { method: "POST", form: body });
    // Another picture, camera or floor was chosen meanwhile: the lens is not that one's.
    if (this.picture.blob !== blob || this.floors.current !== current) return;
    if (!answer.located) throw new Error(reasonWords(answer.reason).join(" "));
    const values = { intrinsics: intrinsicsText(answer.camera) };
    const isHere = answer.plan && answer.floor === this.floors.current.id && this.form.x === "";
    if (isHere) {
      const { x, y, z } = answer.pose.position;
      const [a, b, c, d] = this.floors.current.plan_from_world[2];
      Object.assign(values, { x: answer.plan.x.toFixed(2), y: answer.plan.y.toFixed(2), height: (a * x + b * y + c * z + d).toFixed(2) });
    }
    this.change(values);
    const words = isHere ? "The lens is found, and where the camera hangs." : "The lens is found.";
    byId("board-error").replaceChildren(notice("good", `${words} Undo brings back what was there.`));
  }

  changed() {
    const { history, form } = this;
    for (const [name, id] of Object.entries(FIELDS)) {
      if (byId(id).value.trim() !== form[name]) byId(id).value = form[name];
    }
    byId("camera-keep").checked = form.keep;
    byId("camera-undo").disabled = history.past.length === 0;
    byId("camera-redo").disabled = history.future.length === 0;
    const isKnown = this.anchors.some((anchor) => anchor.id === form.id);
    byId("camera-title").textContent = isKnown ? `The camera ${form.id}` : "A new camera";
    byId("pois").replaceChildren(...form.pois.map((poi) => this.poiEntry(poi)));
    this.picture.draw(form);
    this.draw();
  }

  poiEntry({ id, distance_m }) {
    const remove = el("button", { type: "button", class: "small", "aria-label": `Remove the place ${id}` }, "Remove");
    remove.addEventListener("click", () => this.change({ pois: this.form.pois.filter((each) => each.id !== id) }));
    return el("li", {}, `${id}, ${Number(distance_m.toFixed(2))} m away `, remove);
  }

  draw() {
    const { board, form } = this;
    if (board.tool !== this) return;
    board.glyphs = [];
    const square = (point, size, kind, ...more) => board.glyph(point, svg("rect", { x: -size / 2, y: -size / 2, width: size, height: size, class: kind }), ...more);
    const others = this.anchors.filter((anchor) => anchor.id !== form.id);
    const shapes = others.map(({ id, position: { x, y } }) => square([x, y], 14, "camera", svg("text", { x: 11, y: 4 }, id)));
    for (const { id, position } of form.pois) shapes.push(board.glyph([position.x, position.y], svg("circle", { r: 6, class: "poi" }), svg("text", { x: 9, y: 4 }, id)));
    if (form.x !== "" && form.y !== "") shapes.push(square([Number(form.x), Number(form.y)], 16, "camera new", svg("text", { x: 12, y: 4 }, form.id)));
    if (form.place) shapes.push(board.glyph(form.place, svg("circle", { r: 6, class: "pin" })));
    board.layer.replaceChildren(...shapes);
  }

  async calibrate(anchor) {
    const isShown = this.form.id === anchor.id;
    const form = new FormData();
    if (isShown && this.picture.blob) form.set("image", this.picture.blob, "picture");
    else if (!anchor.frame?.image_stored) throw new Error("Press Edit at this camera, and choose a picture from it.");
    const sent = form.has("image") ? { form } : {};
    await requestJson(path("anchors", anchor.id, "calibrate"), { method: "POST", ...sent });
    byId("board-error").replaceChildren(notice("good", `${anchor.id} is found in the map.`));
    await this.refresh();
  }

  remove(anchor, button) {
    if (!confirm(`Delete the camera ${anchor.id}?`)) return;
    guarded(button, byId("board-error"), async () => {
      await request(path("anchors", anchor.id), { method: "DELETE" });
      if (this.form.id === anchor.id) this.history.stored(EMPTY);
      await this.refresh();
    });
  }

  saveSurely() {
    // A place that was described and not added yet belongs to it.
    if (this.form.name && this.form.region) this.addPoi();
    const { form: pressed } = this;
    return surely(this.floors, () => this.save(pressed));
  }

  /** Store the camera for which the button was pressed, as it is now, or as it was when another one is in the form. */
  async save(pressed) {
    const isShown = this.form.id === pressed.id;
    const form = isShown ? this.form : pressed;
    const before = this.history.mark();
    const body = bodyOf(form, this.floors.venue, this.floors.current.id);
    const stored = await requestJson(path("anchors", form.id), { method: "PUT", json: body });
    // What was changed while this was on its way stays unsaved.
    if (isShown) this.history.storedAt(before, formOf(stored));
    const name = this.form.id === form.id ? "The camera" : `The camera ${form.id}`;
    byId("board-error").replaceChildren(notice("good", `${name} is stored. Push its pictures to it with roomfix push-frames.`));
    // It is stored, even if the list can't be read now.
    await this.refresh().catch(() => {});
    this.changed();
    this.onStored();
  }
}
