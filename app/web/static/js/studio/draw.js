// Areas, landmarks and links: drawn, moved, named and deleted on the plan, with undo, redo and a draft.

import { requestJson } from "../api.js";
import { byId, el, guarded, notice, showError, svg } from "../dom.js";
import { venuePath } from "../venues.js";
import { FloorLinks } from "./floor-links.js";
import { History } from "./history.js";
import { surely } from "./saving.js";

// Points closer than this on the screen are taken for the same.
const SNAP_PX = 14;
const WORDS = {
  select: "Click a feature to name, move or delete it.",
  landmark: "Click where people can go, or be guided by: doors, counters, exhibits.",
  poi: "Click what can be seen or reached there: a screen, an exhibit, a counter.",
  link: "Click along a way that can be walked, from landmark to landmark. Click the last point twice to end it.",
  floors: "Click where the stairs, lift or escalator begins, best on a landmark; then choose where it leads to.",
  area: "Click the corners of a room. Click the last corner twice to close it.",
  route: "Click where a walk begins, then where it ends.",
};

// Kinds of features that are points, and what a new one is called.
const POINTS = { landmark: "Landmark", poi: "Point" };

export class DrawTool {
  constructor(board, floors, onStored) {
    Object.assign(this, { board, floors, onStored, mode: "select", chosen: null, points: [], route: null });
    this.history = new History(() => this.changed());
    this.ways = new FloorLinks(floors, (change) => {
      if (this.chosen !== null) this.history.change((all) => change(all[this.chosen].properties));
    });
    for (const button of byId("draw-panel").querySelectorAll("[data-tool]")) {
      button.addEventListener("click", () => this.choose(button.dataset.tool));
    }
    byId("undo").addEventListener("click", () => this.history.undo());
    byId("redo").addEventListener("click", () => this.history.redo());
    byId("remove").addEventListener("click", () => this.remove());
    byId("finish").addEventListener("click", () => this.finish());
    byId("feature-name").addEventListener("change", () => this.rename());
    // A name is done: the keyboard goes on with the next place.
    byId("feature-name").addEventListener("keydown", (event) => {
      if (event.key === "Enter") board.box.focus();
    });
    byId("save-features").addEventListener("click", () => this.saved());
    addEventListener("keydown", (event) => this.shortcut(event));
  }

  async begin(isLatest) {
    Object.assign(this, { chosen: null, points: [], route: null });
    const { current, venue } = this.floors;
    if (!current) return;
    const [collection, landmarks] = await Promise.all([requestJson(this.floors.path("features")), this.ways.read()]);
    if (!isLatest()) return;
    this.ways.landmarks = landmarks;
    if (this.history.begin(`${venue}.${current.id}`, collection.features)) {
      byId("board-error").replaceChildren(notice("info", "What you drew and didn't save is back. Save it, or undo it."));
    }
    this.choose("select");
  }

  get features() {
    return this.history.value === null ? [] : this.history.get();
  }

  choose(mode) {
    Object.assign(this, { mode, points: [], route: null });
    if (mode !== "select") this.chosen = null;
    for (const button of byId("draw-panel").querySelectorAll("[data-tool]")) {
      button.setAttribute("aria-pressed", String(button.dataset.tool === mode));
    }
    const refusal = mode === "floors" ? this.ways.refusal() : null;
    byId("draw-words").textContent = mode === "route" && this.history.dirty ? "Save first: routes use what is saved." : (refusal ?? WORDS[mode]);
    this.draw();
  }

  shortcut(event) {
    if (!byId("draw-panel").hidden && !event.target.matches("input, textarea")) this.history.shortcut(event);
  }

  key(event) {
    const hasBegun = this.points.length > 0 || this.route !== null || this.chosen !== null;
    if (event.key === "Escape" && hasBegun) this.dropBegun();
    else if ((event.key === "Delete" || event.key === "Backspace") && this.chosen !== null) this.remove();
    else return false;
    return true;
  }

  dropBegun() {
    this.chosen = null;
    this.choose(this.mode);
    this.changed();
  }

  /** Say where the cross is, what it is on, and how much of a line is drawn. */
  describe(point) {
    const [x, y] = this.snapped(point).map((value) => value.toFixed(2));
    const feature = this.features[this.hit(point)];
    const on = feature ? `, on ${kindOf(feature)} ${feature.properties.name ?? ""}`.trimEnd() : "";
    const drawn = this.points.length ? ` ${this.points.length} points are drawn.` : "";
    return `At ${x}, ${y} m${on}.${drawn}`;
  }

  click(raw) {
    const point = this.snapped(raw);
    if (this.mode === "select") return this.select(this.hit(raw));
    if (this.mode in POINTS) {
      const kind = this.mode;
      const number = 1 + this.features.filter((each) => kindOf(each) === kind).length;
      return this.add("Point", point, { kind, name: `${POINTS[kind]} ${number}` });
    }
    if (this.mode === "floors") {
      const properties = this.ways.refusal() === null ? this.ways.propertiesAt(point) : null;
      return properties && this.add("Point", point, properties);
    }
    if (this.mode === "route") return this.tryRoute(point);
    const last = this.points.at(-1);
    if (last && Math.hypot(last[0] - point[0], last[1] - point[1]) < 6 * this.board.metresPerPx) return this.finish();
    this.points.push(point);
    return this.draw();
  }

  finish() {
    const { points } = this;
    this.points = [];
    if (this.mode === "link" && points.length > 1) {
      this.add("LineString", points, { kind: "link", mode: "walk" }, false);
    } else if (this.mode === "area" && points.length > 2) {
      const number = 1 + this.features.filter((each) => kindOf(each) === "area").length;
      this.add("Polygon", [[...points, points[0]]], { kind: "area", name: `Area ${number}` });
    } else {
      this.draw();
    }
  }

  add(type, coordinates, properties, select = true) {
    const rounded = JSON.parse(JSON.stringify(coordinates, (_, value) => (typeof value === "number" ? Number(value.toFixed(3)) : value)));
    this.history.change((all) => all.push({ type: "Feature", geometry: { type, coordinates: rounded }, properties }));
    if (!select) return;
    this.chosen = this.features.length - 1;
    this.changed();
    const field = byId(properties.kind === "link" ? "link-mode" : "feature-name");
    field.focus();
    field.select?.();
  }

  select(index) {
    this.chosen = index;
    this.changed();
  }

  rename() {
    const name = byId("feature-name").value.trim();
    if (this.chosen !== null && name) this.history.change((all) => (all[this.chosen].properties.name = name));
  }

  remove() {
    const { chosen } = this;
    this.chosen = null;
    this.history.change((all) => all.splice(chosen, 1));
  }

  dragStart(point) {
    if (this.mode !== "select") return false;
    const found = this.vertex(point);
    if (found) this.dragged = { ...found, before: this.history.value };
    return found !== null;
  }

  drag(raw) {
    const { feature, place } = this.dragged;
    const [x, y] = this.snapped(raw, feature).map((value) => Number(value.toFixed(3)));
    const all = JSON.parse(this.dragged.before);
    for (const spot of place(all[feature])) spot.splice(0, 2, x, y);
    this.preview = all;
    this.draw();
  }

  drop() {
    const { preview } = this;
    this.preview = null;
    if (preview) this.history.change((all) => all.splice(0, all.length, ...preview));
  }

  cancelDrag() {
    this.preview = null;
    this.draw();
  }

  /** Return the vertex that is pressed, and what finds it in a copy: both ends of a closed ring are one. */
  vertex(point) {
    const near = SNAP_PX * this.board.metresPerPx;
    let [best, found] = [near, null];
    this.features.forEach((each, feature) => {
      positions(each).forEach((spot, i) => {
        const distance = Math.hypot(spot[0] - point[0], spot[1] - point[1]);
        if (distance >= best) return;
        best = distance;
        found = { feature, place: (copy) => positions(copy).filter((other, j) => j === i || (kindOf(copy) === "area" && other[0] === spot[0] && other[1] === spot[1])) };
      });
    });
    return found;
  }

  /** Return the nearest position of another feature, if it is close on the screen, else the point itself. */
  snapped(point, without = -1) {
    let [best, found] = [SNAP_PX * this.board.metresPerPx, point];
    const spots = this.features.flatMap((each, i) => (i === without ? [] : positions(each)));
    for (const spot of [...spots, ...this.points]) {
      const distance = Math.hypot(spot[0] - point[0], spot[1] - point[1]);
      if (distance < best) [best, found] = [distance, [spot[0], spot[1]]];
    }
    return found;
  }

  /** Return the feature at a point: points before lines before areas, of areas the last drawn; the next one of several
   * after the one that is chosen. */
  hit(point) {
    const near = SNAP_PX * this.board.metresPerPx;
    const all = this.features;
    const close = (index) => distanceTo(all[index], point) < near;
    const order = ["Point", "LineString"].flatMap((type) => all.flatMap((each, i) => (each.geometry.type === type ? [i] : [])));
    const areas = all.flatMap((each, i) => (each.geometry.type === "Polygon" && isInside(each.geometry.coordinates[0], point) ? [i] : []));
    const found = order.filter(close);
    return found[(found.indexOf(this.chosen) + 1) % Math.max(1, found.length)] ?? areas.at(-1) ?? null;
  }

  async tryRoute(point) {
    if (this.points.length !== 1) {
      Object.assign(this, { points: [point], route: null });
      return this.draw();
    }
    const floor = this.floors.current.id;
    const { points } = this;
    const [from, to] = [this.points[0], point].map(([x, y]) => `${floor}:${x.toFixed(3)},${y.toFixed(3)}`);
    points.push(point);
    try {
      const route = await requestJson(`${venuePath("route")}?${new URLSearchParams({ from, to })}`);
      // Another tool, floor or beginning was chosen meanwhile.
      if (this.points !== points) return undefined;
      this.route = route;
      byId("draw-words").textContent = `${this.route.distance_m.toFixed(1)} m: ${this.route.steps.map((step) => step.instruction).join(" ")}`;
    } catch (error) {
      if (this.points !== points) return undefined;
      byId("draw-words").textContent = error.message;
    }
    return this.draw();
  }

  changed() {
    const { history } = this;
    const chosen = this.chosen === null ? null : (this.features[this.chosen] ?? null);
    if (chosen === null) this.chosen = null;
    byId("undo").disabled = history.past.length === 0;
    byId("redo").disabled = history.future.length === 0;
    byId("save-features").disabled = !history.dirty;
    byId("remove").hidden = chosen === null;
    byId("feature-form").hidden = chosen === null || kindOf(chosen) === "link";
    this.ways.show(chosen);
    if (chosen && document.activeElement !== byId("feature-name")) byId("feature-name").value = chosen.properties.name ?? "";
    else if (chosen && byId("feature-name").value === "") byId("feature-name").value = chosen.properties.name ?? "";
    this.list();
    this.draw();
  }

  list() {
    byId("feature-list").replaceChildren(
      ...this.features.map((each, i) => {
        const way = each.properties.to_floor === undefined ? `${each.properties.mode ?? "walk"} of ${positions(each).length} points` : this.ways.label(each.properties);
        const name = each.properties.name ?? way;
        const button = el("button", { type: "button", class: "small", "aria-pressed": String(i === this.chosen) }, `${kindOf(each)}: ${name}`);
        button.addEventListener("click", () => {
          this.choose("select");
          this.select(i);
        });
        return el("li", {}, button);
      }),
    );
  }

  draw() {
    const { board } = this;
    if (board.tool !== this) return;
    board.glyphs = [];
    const all = this.preview ?? this.features;
    const rank = { Polygon: 0, LineString: 1, Point: 2 };
    const order = all.map((each, i) => [each, i]).sort(([a], [b]) => rank[a.geometry.type] - rank[b.geometry.type]);
    const shapes = order.map(([each, i]) => this.shape(each, i === this.chosen));
    if (this.route) {
      const here = this.route.path.filter((point) => point.floor === this.floors.current.id);
      shapes.push(svg("polyline", { points: board.line(here.map(({ x, y }) => [x, y])), class: "route" }));
    }
    if (this.points.length > 1 && this.mode !== "route") shapes.push(svg("polyline", { points: board.line(this.points), class: "drawing" }));
    shapes.push(...this.points.map((point) => board.glyph(point, svg("circle", { r: 5, class: "pin" }))));
    board.layer.replaceChildren(...shapes);
    byId("finish").hidden = !(["link", "area"].includes(this.mode) && this.points.length > 1);
  }

  shape(feature, isChosen) {
    const { board } = this;
    const { type, coordinates } = feature.geometry;
    const kind = `${kindOf(feature)}${isChosen ? " chosen" : ""}`;
    if (kindOf(feature) === "link" && type === "Point") {
      const words = svg("text", { x: 12, y: 18 }, this.ways.label(feature.properties));
      return board.glyph(coordinates, svg("rect", { x: -9, y: -9, width: 18, height: 18, class: `way-up ${kind}` }), words);
    }
    if (type === "Point") return board.glyph(coordinates, svg("circle", { r: 7, class: kind }), svg("text", { x: 10, y: 4 }, feature.properties.name ?? ""));
    if (type === "LineString") return svg("polyline", { points: board.line(coordinates), class: kind });
    const middle = coordinates[0].slice(1).reduce(([a, b], [x, y], _, { length }) => [a + x / length, b + y / length], [0, 0]);
    const rings = coordinates.map((ring) => `M ${ring.map((point) => board.units(point).join(" ")).join(" L ")} Z`).join(" ");
    const label = board.glyph(middle, svg("text", { "text-anchor": "middle" }, feature.properties.name ?? ""));
    return svg("g", {}, svg("path", { d: rings, class: kind, "fill-rule": "evenodd" }), label);
  }

  /** Save; the button then has nothing to do, and the keyboard goes on to the next view. */
  async saved() {
    const button = byId("save-features");
    await guarded(button, byId("board-error"), () => this.saveSurely());
    const hadFocus = document.activeElement === button;
    this.changed();
    if (hadFocus && button.disabled) byId("next-of-board").focus({ preventScroll: true });
  }

  saveSurely() {
    return surely(this.floors, () => this.save());
  }

  async save() {
    showError(byId("board-error"), null);
    const before = this.history.mark();
    const where = this.floors.path("features");
    const body = { type: "FeatureCollection", features: this.features };
    const stored = await requestJson(where, { method: "PUT", json: body });
    const now = await requestJson(where);
    const warnings = stored.warnings ?? [];
    // What was drawn while this was on its way stays unsaved.
    if (!this.history.storedAt(before, now.features)) warnings.unshift("What you drew since you pressed Save is not saved yet.");
    byId("board-error").replaceChildren(notice("good", "Saved."), ...warnings.map((words) => notice("info", words)));
    this.onStored();
  }
}

const kindOf = (feature) => feature.properties.kind;

/** Return the positions of a feature, the very arrays. */
function positions({ geometry: { type, coordinates } }) {
  if (type === "Point") return [coordinates];
  return type === "LineString" ? coordinates : coordinates.flat();
}

function distanceTo({ geometry: { type, coordinates } }, [x, y]) {
  if (type === "Point") return Math.hypot(coordinates[0] - x, coordinates[1] - y);
  return Math.min(
    ...coordinates.slice(1).map(([bx, by], i) => {
      const [ax, ay] = coordinates[i];
      const length = (bx - ax) ** 2 + (by - ay) ** 2;
      const along = length ? Math.min(1, Math.max(0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length)) : 0;
      return Math.hypot(ax + along * (bx - ax) - x, ay + along * (by - ay) - y);
    }),
  );
}

function isInside(ring, [x, y]) {
  let inside = false;
  for (let i = 1; i < ring.length; i += 1) {
    const [[ax, ay], [bx, by]] = [ring[i - 1], ring[i]];
    if (ay > y !== by > y && x < ax + ((y - ay) / (by - ay)) * (bx - ax)) inside = !inside;
  }
  return inside;
}
