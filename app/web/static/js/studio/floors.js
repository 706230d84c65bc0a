// The floors of the venue, which one the board shows, and adding and deleting one.

import { path, request, requestJson } from "../api.js";
import { byId, el, guarded, showError } from "../dom.js";
import { PlanTiles } from "../plan-tiles.js";
import { currentVenue, venuePath } from "../venues.js";

// A storey where nothing else is known.
const STOREY_M = 3.5;

export class Floors {
  /** `onShow` runs when another floor is shown, or the shown one has changed. */
  constructor(board, onShow) {
    Object.assign(this, { board, onShow, all: [], current: null });
    byId("floor").addEventListener("change", () => this.show(byId("floor").value));
    byId("new-floor").addEventListener("click", () => this.openDialog());
    byId("floor-cancel").addEventListener("click", () => byId("floor-dialog").close());
    byId("floor-form").addEventListener("submit", (event) => {
      event.preventDefault();
      guarded(event.submitter, byId("floor-error"), () => this.add());
    });
    byId("delete-floor").addEventListener("click", (event) => {
      const sentence = `Delete the floor ${this.current.name} with its plan and all that is drawn on it?`;
      if (confirm(sentence)) guarded(event.target, byId("board-error"), () => this.remove());
    });
  }

  async load(wanted = this.current?.id) {
    const venue = currentVenue();
    const all = venue ? await requestJson(venuePath("floors")) : [];
    // Another venue was chosen meanwhile: its floors are read by a call of its own.
    if (currentVenue()?.id !== venue?.id) return;
    this.all = all;
    const select = byId("floor");
    select.replaceChildren(...this.all.map((floor) => el("option", { value: floor.id }, floor.name)));
    if (!this.all.length) select.append(el("option", { value: "" }, "No floor yet"));
    select.disabled = this.all.length === 0;
    byId("new-floor").disabled = currentVenue() === null;
    const found = this.all.find((floor) => floor.id === wanted) ?? this.all.find((floor) => floor.level === 0) ?? this.all[0];
    await this.show(found?.id ?? null);
  }

  async show(id) {
    this.current = this.all.find((floor) => floor.id === id) ?? null;
    byId("delete-floor").hidden = this.current === null;
    if (this.current) byId("floor").value = id;
    const { plan = null } = this.current ?? {};
    let image = null;
    if (plan) {
      image = { width: plan.width_px, height: plan.height_px, metersPerPixel: plan.meters_per_pixel, origin: plan.origin_px };
      if (plan.tiles) image.tiles = new PlanTiles(plan, this.path("plan"));
      else image.url = await this.imageUrl();
    }
    this.board.show(image);
    byId("board-name").textContent = this.current ? `Plan of ${this.current.name}` : "Plan";
    this.onShow();
  }

  async imageUrl() {
    const response = await request(this.path("plan"));
    if (this.url) URL.revokeObjectURL(this.url);
    this.url = URL.createObjectURL(await response.blob());
    return this.url;
  }

  path(...parts) {
    return `${venuePath("floors", this.current.id)}${parts.map((part) => `/${path(part)}`).join("")}`;
  }

  /** Which floor of which venue is shown, null for none. */
  get place() {
    return this.current && this.path();
  }

  openDialog() {
    byId("floor-form").reset();
    byId("floor-level").value = String(this.all.length ? Math.max(...this.all.map((floor) => floor.level)) + 1 : 0);
    showError(byId("floor-error"), null);
    byId("floor-dialog").showModal();
  }

  async add() {
    const level = Number(byId("floor-level").value);
    const id = String(level).replace("-", "b");
    if (this.all.some((floor) => floor.id === id)) throw new Error("There is a floor of this level already.");
    const heights = { z_min_m: level * STOREY_M - 0.5, z_max_m: (level + 1) * STOREY_M - 0.5 };
    const body = { name: byId("floor-name").value, level, ...heights };
    await requestJson(venuePath("floors", id), { method: "PUT", json: body });
    byId("floor-dialog").close();
    await this.load(id);
  }

  async remove() {
    await request(this.path(), { method: "DELETE" });
    this.current = null;
    await this.load();
  }

  /** Store changes of the shown floor; what is not named stays. */
  async put(changes) {
    const floor = this.current;
    const { name, level, z_min_m, z_max_m, plan_from_world } = floor;
    const body = { name, level, z_min_m, z_max_m, plan_from_world, ...changes };
    const stored = await requestJson(this.path(), { method: "PUT", json: body });
    // Another floor may be shown by now.
    Object.assign(floor, stored);
    return stored;
  }
}
