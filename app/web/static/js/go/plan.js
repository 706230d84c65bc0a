// The plan of a floor with the route, the trail, and the dot of the person with its accuracy and heading.

import { request, requestJson, path } from "../api.js";
import { byId, el, svg } from "../dom.js";
import { PlanTiles } from "../plan-tiles.js";
import { Viewport } from "../viewport.js";
import { say } from "./words.js";

// Half of the longer side of what is shown around the person at first, metres.
const AROUND_M = 9;
const TRAIL_POINTS = 300;
const GRID_M = 0.02;
// After a plan's picture could not be read it is tried again, with an answer that comes later than this.
const RETRY_MS = 2000;

export class Plan {
  constructor(venue) {
    this.venue = venue;
    this.svg = byId("plan-svg");
    this.ground = svg("g");
    this.way = svg("polyline", { class: "way" });
    this.trailLine = svg("polyline", { class: "trail" });
    this.goal = svg("g", { class: "goal", visibility: "hidden" }, svg("path", { d: "M0 0 L-8 -14 A 9 9 0 1 1 8 -14 Z" }), svg("circle", { r: 3.5, cy: -19 }));
    this.halo = svg("circle", { class: "halo" });
    this.turn = svg("path", { d: "M 46 -24 A 52 52 0 0 1 46 24 L 0 0 Z", class: "beam" });
    this.dot = svg("g", {}, this.turn, svg("circle", { r: 10, class: "dot" }));
    this.you = svg("g", { class: "you", visibility: "hidden" }, this.halo, this.dot);
    this.svg.append(this.ground, this.trailLine, this.way, this.goal, this.you);
    this.viewport = new Viewport(this.svg, byId("plan"), () => this.rescale());
    this.floors = [];
    this.images = new Map();
    // Floor -> when its picture was asked for, until it is there.
    this.triedAt = new Map();
    this.shown = null;
    // The floor that is to be shown, while its plan is on its way.
    this.wanted = null;
    this.place = null;
    this.trail = [];
    this.route = [];
    this.following = true;
    this.zoomed = false;
    // Runs when another floor is shown.
    this.onShown = () => {};
    byId("plan").addEventListener("pointerdown", (event) => {
      if (event.target.closest("button") === null) this.follow(false);
    });
    byId("follow").addEventListener("click", () => this.follow(!this.following));
  }

  /** Read the floors, once, and show one; returns them. */
  load() {
    this.reading ??= this.read().catch((error) => {
      this.reading = null;
      throw error;
    });
    return this.reading;
  }

  async read() {
    this.floors = await requestJson(path("venues", this.venue, "floors"));
    const shown = [...this.floors].sort((a, b) => b.level - a.level);
    byId("floors").replaceChildren(
      ...(shown.length > 1 ? shown : []).map((floor) =>
        el("button", { type: "button", class: "small", "data-floor": floor.id, on: { click: () => this.choose(floor.id) } }, floor.name),
      ),
    );
    // Where the person is already known to be is shown instead.
    const first = this.floor(this.place?.floor) ?? this.floors.find((floor) => floor.level === 0) ?? this.floors[0];
    if (first && this.wanted === null) this.show(first.id);
    return this.floors;
  }

  floor(id) {
    return this.floors.find((floor) => floor.id === id) ?? null;
  }

  /** The name of the floor on which the person is, while they look at another one; else null. */
  get otherFloor() {
    if (this.place === null || this.following || this.place.floor === this.shown) return null;
    return this.floor(this.place.floor)?.name ?? null;
  }

  /** Show a floor that the person chose: the plan doesn't follow any more. */
  choose(id) {
    this.follow(false);
    return this.show(id);
  }

  async show(id) {
    const floor = this.floor(id);
    if (!floor) return;
    // Its plan is on its way already.
    if (this.wanted === id && this.shown !== id) return;
    this.wanted = id;
    const again = performance.now() > (this.triedAt.get(id) ?? Infinity) + RETRY_MS;
    if (this.shown !== id || again) {
      const { plan } = floor;
      // Without its picture a floor is shown as empty ground.
      const url = plan && !plan.tiles ? await this.image(id) : null;
      if (this.wanted !== id || (this.shown === id && url === null)) return;
      const tiles = plan?.tiles ? new PlanTiles(plan, path("venues", this.venue, "floors", id, "plan")) : null;
      this.shown = id;
      const content = plan
        ? { x: -0.5, y: -0.5, width: plan.width_px, height: plan.height_px }
        : { x: -500, y: -500, width: 1000, height: 1000 };
      if (tiles) this.ground.replaceChildren(tiles.node);
      else this.ground.replaceChildren(...(url ? [svg("image", { href: url, ...content })] : []));
      this.viewport.setContent(content, tiles);
      this.zoomed = false;
    }
    for (const button of byId("floors").children) {
      button.setAttribute("aria-pressed", String(button.dataset.floor === id));
    }
    this.markFloor();
    byId("plan").setAttribute("aria-label", say("plan", { floor: floor.name }));
    byId("plan-title").textContent = floor.name;
    this.draw();
    this.onShown();
  }

  /** Return the address of a floor's picture in memory, null where it can't be read now. */
  async image(id) {
    if (this.images.has(id)) return this.images.get(id);
    this.triedAt.set(id, performance.now());
    try {
      const response = await request(path("venues", this.venue, "floors", id, "plan"));
      this.images.set(id, URL.createObjectURL(await response.blob()));
    } catch {
      return null;
    }
    this.triedAt.delete(id);
    return this.images.get(id);
  }

  /** Show where the person is: `{floor, x, y, headingDeg, accuracyM, number}`. */
  move(place) {
    this.place = place;
    this.stale(false);
    this.markFloor();
    this.trail.push([place.floor, place.x, place.y]);
    this.trail.splice(0, this.trail.length - TRAIL_POINTS);
    if (this.following && (place.floor !== this.shown || this.triedAt.has(place.floor))) this.show(place.floor);
    this.draw();
  }

  /** Mark the floor on which the person is, whichever is shown. */
  markFloor() {
    for (const button of byId("floors").children) {
      if (button.dataset.floor === this.place?.floor) button.setAttribute("aria-current", "location");
      else button.removeAttribute("aria-current");
    }
  }

  /** Show whether the dot is where the person was, and not is. */
  stale(isStale) {
    this.you.classList.toggle("stale", isStale);
  }

  /** Show a route: its path as `[{floor, x, y}]`; empty for none. */
  lead(route) {
    this.route = route;
    this.draw();
  }

  follow(on) {
    this.following = on;
    byId("follow").setAttribute("aria-pressed", String(on));
    if (on && this.place) {
      this.zoomed = false;
      this.show(this.place.floor);
    }
  }

  draw() {
    const here = ([floor]) => floor === this.shown;
    this.trailLine.setAttribute("points", this.line(this.trail.filter(here).map(([, x, y]) => [x, y])));
    const onFloor = this.route.filter((point) => point.floor === this.shown);
    this.way.setAttribute("points", this.line(onFloor.map(({ x, y }) => [x, y])));
    const end = this.route.at(-1);
    this.goal.setAttribute("visibility", end && end.floor === this.shown ? "visible" : "hidden");
    if (end) this.goalAt = this.point(end.x, end.y);
    const { place } = this;
    const visible = place !== null && place.floor === this.shown;
    this.you.setAttribute("visibility", visible ? "visible" : "hidden");
    if (visible) {
      const [u, v] = this.point(place.x, place.y);
      this.at = [u, v];
      this.halo.setAttribute("cx", u);
      this.halo.setAttribute("cy", v);
      this.halo.setAttribute("r", Math.max(place.accuracyM, 0.05) / this.unitM());
      this.turn.setAttribute("transform", `rotate(${-place.headingDeg})`);
      this.you.dataset.x = place.x;
      this.you.dataset.y = place.y;
      this.you.dataset.frame = place.number;
      if (this.following) this.center(u, v);
    }
    this.rescale();
  }

  center(u, v) {
    const { viewport } = this;
    if (!this.zoomed) {
      const side = Math.min(viewport.box.clientWidth, viewport.box.clientHeight);
      viewport.view.unitsPerPx = Math.min(viewport.view.unitsPerPx, (2 * AROUND_M) / this.unitM() / Math.max(side, 1));
      this.zoomed = true;
    }
    viewport.following = false;
    Object.assign(viewport.view, { x: u, y: v });
    viewport.setFocus([u, v]);
    viewport.apply();
  }

  unitM() {
    return this.floor(this.shown)?.plan?.meters_per_pixel ?? GRID_M;
  }

  point(x, y) {
    const [u, v] = this.floor(this.shown)?.plan?.origin_px ?? [0, 0];
    return [u + x / this.unitM(), v - y / this.unitM()];
  }

  line(points) {
    return points.map(([x, y]) => this.point(x, y).join(",")).join(" ");
  }

  // Dot and goal keep their size on the screen.
  rescale() {
    const { unitsPerPx } = this.viewport ?? {};
    if (!unitsPerPx) return;
    if (this.at) this.dot.setAttribute("transform", `translate(${this.at[0]} ${this.at[1]}) scale(${unitsPerPx})`);
    if (this.goalAt) this.goal.setAttribute("transform", `translate(${this.goalAt[0]} ${this.goalAt[1]}) scale(${unitsPerPx})`);
  }
}
