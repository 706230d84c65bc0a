// The floors of the venue, which one the board shows, and adding and deleting one.

import { path, request, requestJson } from "../api.js";
import { byId, el, guarded, showError } from "../dom.js";
import { PlanTiles } from "../plan-tiles.js";
import { turns } from "../turns.js";
import { currentVenue } from "../venues.js";

// A storey where nothing else is known.
const STOREY_M = 3.5;
const RETRY_MS = 2000;

export class Floors {
  /** `onShow` runs when another floor is shown, or the shown one has changed; and before, when one is on its way. */
  constructor(board, onShow) {
    Object.assign(this, { board, onShow, venue: null, all: [], current: null, url: null, isLoading: true, lists: turns(), turn: turns() });
    byId("floor").addEventListener("change", () => this.showSurely(byId("floor").value));
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

  /** Read the floors of the chosen venue, and show one: the wanted one, or the one that is shown, or the ground floor. */
  async load(wanted = this.venue === currentVenue()?.id ? this.current?.id : undefined) {
    const venue = currentVenue()?.id ?? null;
    const before = byId("floor").value;
    const isLatest = this.lists();
    // The plan of the venue before is not shown any more, if it is on its way.
    if (this.venue !== venue) this.turn();
    this.begin();
    const all = venue === null ? [] : await requestJson(path("venues", venue, "floors"));
    // Another venue was chosen, or a floor changed, meanwhile: floors are read by a call of its own.
    if (!isLatest()) return;
    const select = byId("floor");
    const chosen = this.venue === venue && select.value !== before ? select.value : wanted;
    Object.assign(this, { venue, all });
    select.replaceChildren(...all.map((floor) => el("option", { value: floor.id }, floor.name)));
    if (!all.length) select.append(el("option", { value: "" }, "No floor yet"));
    select.disabled = all.length === 0;
    byId("new-floor").disabled = venue === null;
    const found = all.find((floor) => floor.id === chosen) ?? all.find((floor) => floor.level === 0) ?? all[0];
    await this.show(found?.id ?? null);
  }

  /** Load, again and again while the server can't be reached. */
  async loadSurely(wanted) {
    const venue = currentVenue()?.id;
    const place = byId("page-error");
    for (;;) {
      try {
        return await this.load(wanted);
      } catch (error) {
        if (currentVenue()?.id !== venue) return undefined;
        if (error.status !== 0) throw error;
        showError(place, error);
        await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
        if (currentVenue()?.id !== venue) return undefined;
        showError(place, null);
      }
    }
  }

  /** Say that another floor is on its way: until it is there, nothing may be done to the one that is still drawn. */
  begin() {
    this.isLoading = true;
    // One floor's buttons would act on another venue's floor of the same id.
    if (this.venue !== (currentVenue()?.id ?? null)) {
      byId("floor").disabled = true;
      byId("new-floor").disabled = true;
    }
    byId("delete-floor").hidden = true;
    this.onShow();
  }

  async show(id) {
    const isLatest = this.turn();
    this.begin();
    const floor = this.all.find((each) => each.id === id) ?? null;
    if (floor) byId("floor").value = id;
    const { plan = null } = floor ?? {};
    const url = plan && !plan.tiles ? await imageUrl(`${this.pathOf(floor)}/plan`) : null;
    // Another floor was chosen while the plan of this one was on its way.
    if (!isLatest()) return url && URL.revokeObjectURL(url);
    if (this.url) URL.revokeObjectURL(this.url);
    Object.assign(this, { current: floor, url, isLoading: false });
    byId("delete-floor").hidden = floor === null;
    this.draw();
    byId("board-name").textContent = floor ? `Plan of ${floor.name}` : "Plan";
    return this.onShow();
  }

  /** Draw the stored plan of the shown floor on the board. */
  draw() {
    const { plan = null } = this.current ?? {};
    if (!plan) return this.board.show(null);
    const image = { width: plan.width_px, height: plan.height_px, metersPerPixel: plan.meters_per_pixel, origin: plan.origin_px };
    if (plan.tiles) image.tiles = new PlanTiles(plan, this.path("plan"));
    else image.url = this.url;
    return this.board.show(image);
  }

  /** Show a floor that was chosen; while the server can't be reached it is tried again. */
  async showSurely(id) {
    try {
      showError(byId("board-error"), null);
      await this.show(id);
    } catch (error) {
      if (byId("floor").value !== id) return;
      showError(byId("board-error"), error);
      if (error.status === 0) setTimeout(() => this.isLoading && byId("floor").value === id && this.showSurely(id), RETRY_MS);
    }
  }

  path(...parts) {
    return `${this.pathOf(this.current)}${parts.map((part) => `/${path(part)}`).join("")}`;
  }

  pathOf(floor) {
    return path("venues", this.venue, "floors", floor.id);
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
    await requestJson(path("venues", this.venue, "floors", id), { method: "PUT", json: body });
    byId("floor-dialog").close();
    await this.loadSurely(id);
  }

  async remove() {
    const { current } = this;
    await request(this.path(), { method: "DELETE" });
    if (this.current === current) this.current = null;
    await this.loadSurely();
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

async function imageUrl(where) {
  const response = await request(where);
  return URL.createObjectURL(await response.blob());
}
