// A monitoring camera's picture, from a file or its newest one from the server, with the places marked in it.

import { path, request } from "../api.js";
import { byId, svg } from "../dom.js";
import { seconds } from "../words.js";
import { cornersOf, statedWidth } from "./camera-form.js";
import { Cross } from "./cross.js";

export class CameraPicture {
  /** `onRegion` gets the corners of a place as text, in pixels of what the intrinsics are for. */
  constructor(onRegion) {
    Object.assign(this, { onRegion, blob: null, frame: null, first: null, asked: 0, form: null });
    byId("camera-picture").addEventListener("change", () => this.file());
    const picture = byId("picture");
    picture.addEventListener("click", (event) => this.clicked(event));
    picture.addEventListener("keydown", (event) => this.key(event));
    this.cross = new Cross(picture, byId("picture-says"), {
      unitsPerPx: () => 1 / picture.getScreenCTM().a,
      middle: () => this.image && [this.image.naturalWidth / 2, this.image.naturalHeight / 2],
      limit: ([u, v]) => [Math.min(Math.max(u, 0), this.image.naturalWidth - 1), Math.min(Math.max(v, 0), this.image.naturalHeight - 1)],
      describe: ([u, v]) => `At ${Math.round(u / this.scale)}, ${Math.round(v / this.scale)}.`,
    });
  }

  clear() {
    byId("camera-picture").value = "";
    this.say("");
    this.asked += 1;
    this.use(null);
  }

  /** Show the picture that a camera has pushed, unless it is shown already or a file is. Null: a camera of no server. */
  async live(anchor) {
    const { frame } = anchor;
    if (byId("camera-picture").files.length || !frame?.image_stored) return;
    const words = `Its newest picture, ${seconds(frame.age_s)} old.`;
    // The picture stays while a place is being marked in it.
    if (this.frame === frame.id || this.first) return;
    const asked = (this.asked += 1);
    const response = await request(path("anchors", anchor.id, "picture"));
    const blob = await response.blob();
    if (asked !== this.asked) return;
    await this.use(blob);
    // Another picture was chosen while this one was read.
    if (asked !== this.asked) return;
    this.frame = frame.id;
    this.say(words);
  }

  async file() {
    this.asked += 1;
    await this.use(byId("camera-picture").files[0] ?? null);
    if (this.blob) this.say("Click two corners of a place in it.");
  }

  async use(blob) {
    if (this.image) URL.revokeObjectURL(this.image.src);
    Object.assign(this, { blob, frame: null, first: null, image: null });
    this.cross.forget();
    if (blob) {
      const image = new Image();
      image.src = URL.createObjectURL(blob);
      const isRead = await image.decode().then(() => true, () => false);
      if (this.blob !== blob) return;
      if (!isRead) this.say("The browser can't show this picture. Choose a JPEG or PNG.");
      else this.image = image;
    }
    this.draw();
  }

  say(words) {
    byId("picture-words").textContent = words;
  }

  /** Pixels of the picture for one of what the intrinsics are for. */
  get scale() {
    const width = this.form && statedWidth(this.form.intrinsics);
    return width ? this.image.naturalWidth / width : 1;
  }

  clicked(event) {
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(byId("picture").getScreenCTM().inverse());
    this.corner([x, y]);
  }

  key(event) {
    if (event.key === "Enter" && this.image) this.corner(this.cross.begin());
    else if (event.key === "Escape" && this.first) this.first = null;
    else if (!this.cross.move(event)) return;
    event.preventDefault();
    this.draw();
  }

  corner(point) {
    const corner = point.map((value) => Math.round(value / this.scale));
    if (this.first) {
      const region = [...this.first, ...corner].join(", ");
      this.first = null;
      this.onRegion(region);
    } else {
      this.first = corner;
      this.draw();
    }
  }

  /** Draw the picture with the places of a form. */
  draw(form = this.form) {
    this.form = form;
    byId("picture").toggleAttribute("hidden", !this.image);
    if (!this.image) return;
    const { naturalWidth: width, naturalHeight: height, src } = this.image;
    const { scale } = this;
    const shapes = [svg("image", { href: src, x: -0.5, y: -0.5, width, height })];
    for (const poi of form?.pois ?? []) {
      const corners = poi.region_px.map((corner) => corner.map((value) => value * scale));
      const [u, v] = corners[0];
      shapes.push(svg("polygon", { points: corners.join(" "), class: "region kept" }), svg("text", { x: u + 3, y: v - 5, "font-size": height / 22, class: "region-name" }, poi.id));
    }
    const marked = cornersOf(form?.region ?? "")?.map((value) => value * scale);
    if (marked) {
      const [a, b, c, d] = marked;
      shapes.push(svg("rect", { x: Math.min(a, c), y: Math.min(b, d), width: Math.abs(c - a), height: Math.abs(d - b), class: "region" }));
    }
    if (this.first) shapes.push(svg("circle", { cx: this.first[0] * scale, cy: this.first[1] * scale, r: width / 150, class: "pin" }));
    shapes.push(this.cross.node);
    byId("picture").setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
    byId("picture").replaceChildren(...shapes);
  }
}
