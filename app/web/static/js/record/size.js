// How large the place is: by the printed marker, by a distance that is marked in a picture, or by the phone's height.

import { byId, showError, svg } from "../dom.js";
import { say } from "../go/words.js";

const KINDS = ["marker", "distance", "height", "none"];
const USUAL_M = { marker: "0.16", distance: "", height: "1.5" };
// Pictures that stay on the phone to mark a distance in, spread over the whole recording.
const MAX_SHOTS = 16;
const KEY_STEP = 1 / 200;
const MARK_RATIO = 1 / 60;

export class Size {
  constructor() {
    this.shots = [];
    this.every = 1;
    this.at = 0;
    this.wanted = 0;
    this.points = [];
    this.cross = null;
    for (const radio of this.radios()) radio.addEventListener("change", () => this.choose(radio.value));
    byId("shot-before").addEventListener("click", () => this.show(this.wanted - 1));
    byId("shot-after").addEventListener("click", () => this.show(this.wanted + 1));
    byId("points-again").addEventListener("click", () => this.show(this.at));
    byId("shot").addEventListener("click", (event) => this.click(event));
    byId("shot").addEventListener("keydown", (event) => this.key(event));
  }

  /** Remember some of the pictures. */
  add(number, picture) {
    if (number % this.every) return;
    this.shots.push({ number, picture });
    if (this.shots.length <= MAX_SHOTS) return;
    this.every *= 2;
    this.shots = this.shots.filter((shot) => shot.number % this.every === 0);
  }

  open() {
    this.choose(this.kind());
  }

  kind() {
    return this.radios().find((radio) => radio.checked).value;
  }

  radios() {
    return KINDS.map((kind) => document.querySelector(`input[name="size"][value="${kind}"]`));
  }

  choose(kind) {
    byId("size-points").hidden = kind !== "distance";
    byId("size-value").hidden = kind === "none";
    if (kind !== "none") {
      byId("metres-label").textContent = say(`record.metres.${kind}`);
      byId("metres").value = USUAL_M[kind];
    }
    if (kind === "distance") this.show(this.at);
  }

  /** Return the scale as the server takes it, null for none; throws an `Error` with a sentence for the person. */
  value() {
    const kind = this.kind();
    if (kind === "none") return null;
    const metres = Number(byId("metres").value);
    if (kind === "distance" && this.points.length < 2) throw new Error(say(this.shots.length ? "record.points.missing" : "record.points.gone"));
    if (!(metres > 0)) throw new Error(say("record.metres.missing"));
    if (kind === "marker") return { marker_m: metres };
    if (kind === "height") return { camera_height_m: metres };
    const name = `${String(this.shots[this.at].number).padStart(6, "0")}.jpg`;
    return { distance_m: metres, frame: name, pixels: this.points };
  }

  /** Show a picture, with nothing marked in it. */
  async show(at) {
    const next = Math.min(Math.max(at, 0), Math.max(0, this.shots.length - 1));
    const shot = this.shots[next];
    // The picture before stays, with its marks, until the next one can be drawn: a mark is never of another picture.
    this.wanted = next;
    const size = shot && (await sizeOf(shot.picture));
    if (next !== this.wanted) return;
    this.at = next;
    this.points = [];
    byId("shot-before").disabled = next === 0;
    byId("shot-after").disabled = next >= this.shots.length - 1;
    byId("shot").hidden = !shot;
    if (!shot) {
      byId("points-words").textContent = say("record.points.gone");
      return;
    }
    this.size = size;
    this.cross = size.map((side) => side / 2);
    if (this.url) URL.revokeObjectURL(this.url);
    this.url = URL.createObjectURL(shot.picture);
    byId("shot-title").textContent = say("record.shot", { number: shot.number + 1 });
    this.draw();
  }

  draw() {
    const [width, height] = this.size;
    const root = byId("shot-svg");
    root.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const radius = MARK_RATIO * width;
    const marks = this.points.flatMap(([cx, cy]) =>
      ["mark", "mark-inner"].map((kind) => svg("circle", { class: kind, cx, cy, r: radius, "vector-effect": "non-scaling-stroke" })),
    );
    const [x, y] = this.cross;
    const cross = svg("path", { class: "cross", d: `M${x - radius} ${y}h${2 * radius}M${x} ${y - radius}v${2 * radius}`, "vector-effect": "non-scaling-stroke" });
    const image = svg("image", { href: this.url, width, height });
    root.replaceChildren(byId("shot-title"), image, ...marks, ...(this.points.length < 2 ? [cross] : []));
    const words = ["record.points", "record.points.one", "record.points.done"][this.points.length];
    byId("points-words").textContent = say(words);
  }

  click({ clientX, clientY }) {
    if (!this.size) return;
    // Screen to picture, whatever the size at which it is shown.
    const at = new DOMPoint(clientX, clientY).matrixTransform(byId("shot-svg").getScreenCTM().inverse());
    this.mark([at.x, at.y]);
  }

  key(event) {
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    if (!this.size || (event.key !== "Enter" && !(event.key in moves))) return;
    event.preventDefault();
    if (event.key === "Enter") return this.mark(this.cross);
    const [dx, dy] = moves[event.key];
    const step = KEY_STEP * this.size[0] * (event.shiftKey ? 10 : 1);
    this.cross = [this.cross[0] + step * dx, this.cross[1] + step * dy].map((value, i) => Math.min(Math.max(value, 0), this.size[i] - 1));
    return this.draw();
  }

  mark(at) {
    const point = at.map((value, i) => Number(Math.min(Math.max(value, 0), this.size[i] - 1).toFixed(1)));
    this.points = [...this.points, point].slice(-2);
    showError(byId("size-error"), null);
    this.draw();
  }
}

async function sizeOf(picture) {
  const bitmap = await createImageBitmap(picture);
  const size = [bitmap.width, bitmap.height];
  bitmap.close();
  return size;
}
