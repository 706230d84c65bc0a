// Monitoring cameras: placed by a click, with the places that they see; found in the map by one button.

import { path, request, requestJson } from "../api.js";
import { byId, el, guarded, notice, svg } from "../dom.js";
import { currentVenue } from "../venues.js";
import { seconds } from "../words.js";
import { surely } from "./saving.js";

export class CameraTool {
  constructor(board, floors, onStored) {
    Object.assign(this, { board, floors, onStored, mode: "camera", pois: [], place: null, corners: [], anchors: [] });
    for (const button of byId("camera-panel").querySelectorAll("[data-tool]")) {
      button.addEventListener("click", () => this.choose(button.dataset.tool));
    }
    byId("camera-picture").addEventListener("change", () => this.picture(byId("camera-picture").files[0]));
    byId("picture").addEventListener("click", (event) => this.corner(event));
    byId("add-poi").addEventListener("click", (event) => guarded(event.target, byId("board-error"), () => this.addPoi()));
    for (const id of ["camera-x", "camera-y"]) byId(id).addEventListener("input", () => this.draw());
    byId("camera-panel").addEventListener("submit", (event) => {
      event.preventDefault();
      guarded(byId("save-camera"), byId("board-error"), () => surely(byId("board-error"), () => this.save()));
    });
  }

  async begin() {
    Object.assign(this, { pois: [], place: null, corners: [] });
    byId("camera-panel").inert = this.floors.current === null;
    this.choose("camera");
    if (!currentVenue()) return;
    this.anchors = await requestJson(`anchors?venue=${encodeURIComponent(currentVenue().id)}`);
    this.list();
    this.draw();
  }

  choose(mode) {
    this.mode = mode;
    for (const button of byId("camera-panel").querySelectorAll("[data-tool]")) {
      button.setAttribute("aria-pressed", String(button.dataset.tool === mode));
    }
    byId("camera-words").textContent = mode === "camera" ? "Click where the camera hangs." : "Click where the place is that the camera sees.";
  }

  get camera() {
    const [x, y] = ["camera-x", "camera-y"].map((id) => byId(id).value);
    return x === "" || y === "" ? null : [Number(x), Number(y)];
  }

  click(point) {
    const [x, y] = point.map((value) => Number(value.toFixed(2)));
    if (this.mode === "camera") [byId("camera-x").value, byId("camera-y").value] = [String(x), String(y)];
    else this.place = [x, y];
    if (this.camera && this.place) {
      byId("poi-distance").value = Math.hypot(this.camera[0] - this.place[0], this.camera[1] - this.place[1]).toFixed(2);
    }
    this.draw();
  }

  async picture(file) {
    this.corners = [];
    byId("picture").toggleAttribute("hidden", !file);
    if (!file) return;
    const image = new Image();
    image.src = URL.createObjectURL(file);
    await image.decode().catch(() => null);
    this.image = image;
    byId("region-words").textContent = "Click two corners of a place that is easy to find: a sign, a picture, a poster.";
    this.drawPicture();
  }

  corner(event) {
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(byId("picture").getScreenCTM().inverse());
    this.corners = this.corners.length === 1 ? [this.corners[0], [at.x, at.y]] : [[at.x, at.y]];
    if (this.corners.length === 2) byId("region").value = this.corners.flat().map(Math.round).join(", ");
    this.drawPicture();
  }

  drawPicture() {
    const { naturalWidth: width, naturalHeight: height, src } = this.image;
    byId("picture").setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
    const shapes = [svg("image", { href: src, x: -0.5, y: -0.5, width, height })];
    if (this.corners.length === 2) {
      const [[a, b], [c, d]] = this.corners;
      shapes.push(svg("rect", { x: Math.min(a, c), y: Math.min(b, d), width: Math.abs(c - a), height: Math.abs(d - b), class: "region" }));
    }
    shapes.push(...this.corners.map(([u, v]) => svg("circle", { cx: u, cy: v, r: width / 150, class: "pin" })));
    byId("picture").replaceChildren(...shapes);
  }

  addPoi() {
    const [a, b, c, d, ...rest] = byId("region").value.split(",").map(Number);
    if (rest.length || ![a, b, c, d].every(Number.isFinite)) throw new Error("Click two corners of the place in the picture first.");
    if (!this.place) throw new Error("Press The place, and click where it is on the plan.");
    const id = byId("poi-name").value.trim();
    const distance = Number(byId("poi-distance").value);
    if (!id || !(distance > 0)) throw new Error("The place needs an id and its distance from the camera.");
    const region = [[a, b], [c, b], [c, d], [a, d]];
    this.pois.push({ id, region_px: region, position: { x: this.place[0], y: this.place[1] }, distance_m: distance });
    Object.assign(this, { place: null, corners: [] });
    for (const field of ["region", "poi-name", "poi-distance"]) byId(field).value = "";
    if (this.image) this.drawPicture();
    this.draw();
  }

  draw() {
    const { board } = this;
    board.glyphs = [];
    const here = this.anchors.filter((anchor) => anchor.floor === this.floors.current?.id);
    const shapes = here.map((anchor) => board.glyph([anchor.position.x, anchor.position.y], svg("rect", { x: -7, y: -7, width: 14, height: 14, class: "camera" }), svg("text", { x: 11, y: 4 }, anchor.id)));
    for (const { id, position } of this.pois) shapes.push(board.glyph([position.x, position.y], svg("circle", { r: 6, class: "poi" }), svg("text", { x: 9, y: 4 }, id)));
    if (this.camera) shapes.push(board.glyph(this.camera, svg("rect", { x: -8, y: -8, width: 16, height: 16, class: "camera new" })));
    if (this.place) shapes.push(board.glyph(this.place, svg("circle", { r: 6, class: "pin" })));
    board.layer.replaceChildren(...shapes);
    byId("pois").replaceChildren(...this.pois.map((poi) => el("li", {}, `${poi.id}, ${poi.distance_m} m away`)));
    byId("save-camera").disabled = this.pois.length === 0;
  }

  list() {
    const here = this.anchors.filter((anchor) => anchor.floor === this.floors.current?.id);
    byId("cameras").replaceChildren(...(here.length ? here.map((anchor) => this.entry(anchor)) : [el("li", {}, "None yet.")]));
  }

  entry(anchor) {
    const error = byId("board-error");
    const age = anchor.frame?.age_s;
    const state = age === undefined || age === null ? "no picture yet" : `last picture ${seconds(age)} ago`;
    const find = el("button", { type: "button", class: "small" }, "Find it in the map");
    find.addEventListener("click", () =>
      guarded(find, error, async () => {
        const file = byId("camera-picture").files[0];
        const form = new FormData();
        if (file) form.set("image", file, file.name);
        await requestJson(path("anchors", anchor.id, "calibrate"), { method: "POST", ...(file ? { form } : {}) });
        error.replaceChildren(notice("good", `${anchor.id} is found in the map.`));
        await this.begin();
      }),
    );
    const remove = el("button", { type: "button", class: "small danger" }, "Delete");
    remove.addEventListener("click", () => {
      if (!confirm(`Delete the camera ${anchor.id}?`)) return;
      guarded(remove, error, async () => {
        await request(path("anchors", anchor.id), { method: "DELETE" });
        await this.begin();
      });
    });
    return el("li", {}, el("strong", {}, anchor.id), ` ${state} `, find, " ", remove);
  }

  async save() {
    const [x, y] = this.camera;
    const body = {
      venue: currentVenue().id,
      floor: this.floors.current.id,
      position: { x, y },
      height_m: Number(byId("camera-height").value),
      camera: byId("camera-intrinsics").value.trim(),
      pois: this.pois,
    };
    await requestJson(path("anchors", byId("camera-id").value.trim()), { method: "PUT", json: body });
    byId("board-error").replaceChildren(notice("good", "The camera is stored. Push its pictures to it with roomfix push-frames."));
    await this.begin();
    this.onStored();
  }
}
