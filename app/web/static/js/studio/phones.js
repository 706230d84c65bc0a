// Phones that agreed to be shown, live on the plan, where they could not be located, and where the map locates them.

import { path, requestJson } from "../api.js";
import { byId, el, svg } from "../dom.js";
import { count } from "../words.js";
import { CoverageLayer } from "./coverage.js";

const EVERY_MS = 2000;
// Older places are drawn pale.
const RECENT_S = 10;

export class PhonesTool {
  constructor(board, floors) {
    Object.assign(this, { board, floors, phones: [], timer: null });
    this.coverage = new CoverageLayer(board, floors, () => this.draw());
  }

  async begin(isLatest) {
    this.leave();
    this.phones = [];
    byId("phone-list").replaceChildren();
    if (!this.floors.current) return;
    this.coverage.begin();
    await this.read(isLatest);
    this.again(isLatest);
  }

  leave() {
    clearTimeout(this.timer);
  }

  /** Read again after a while, one answer after the other, until another view or floor is shown. */
  again(isLatest) {
    if (!isLatest()) return;
    this.timer = setTimeout(async () => {
      await this.read(isLatest).catch((error) => isLatest() && this.say(`${error.message} I try again by myself.`));
      this.again(isLatest);
    }, EVERY_MS);
  }

  async read(isLatest) {
    const phones = await requestJson(path("venues", this.floors.venue, "phones"));
    if (!isLatest()) return;
    this.phones = phones;
    const lost = phones.reduce((sum, phone) => sum + phone.lost.length, 0);
    const shown = phones.length === 1 ? "One phone is shown" : `${count(phones.length)} phones are shown`;
    this.say(phones.length ? `${shown}, lost at ${count(lost)} ${lost === 1 ? "place" : "places"}.` : "No phone has agreed to be shown in the last hour.");
    byId("phone-list").replaceChildren(...phones.map((phone) => el("li", {}, this.words(phone))));
    this.draw();
  }

  say(words) {
    if (byId("phone-words").textContent !== words) byId("phone-words").textContent = words;
  }

  words({ phone, tracking, place, active_at: at }) {
    const floor = this.floors.all.find(({ id }) => id === place?.floor)?.name ?? place?.floor;
    const where = place ? `on ${floor} at ${place.x.toFixed(1)}, ${place.y.toFixed(1)} m` : "not located yet";
    return `${phone}: ${tracking}, ${where}, ${Math.max(0, Math.round(secondsSince(at)))} s ago`;
  }

  draw() {
    const { board } = this;
    if (board.tool !== this) return;
    board.glyphs = [];
    const here = (place) => place?.floor === this.floors.current?.id;
    const lost = this.phones.flatMap((phone) => phone.lost.filter(here));
    const found = this.phones.filter(({ place }) => here(place));
    board.layer.replaceChildren(
      ...this.coverage.shapes(),
      ...lost.map(({ x, y, frames }) =>
        board.glyph([x, y], svg("path", { d: "M-6 -6L6 6M6 -6L-6 6", class: "lost-place" }), svg("title", {}, `Lost here for ${frames} pictures`)),
      ),
      ...found.map(({ phone, place, active_at: at }) => {
        const pale = secondsSince(at) > RECENT_S ? " stale" : "";
        const beam = svg("path", { d: "M0 0L26 -11A28 28 0 0 1 26 11Z", class: "beam", transform: `rotate(${-place.heading_deg})` });
        return board.glyph([place.x, place.y], svg("g", { class: `live-phone${pale}` }, beam, svg("circle", { r: 8 })), svg("text", { x: 12, y: 4 }, phone));
      }),
    );
  }
}

const secondsSince = (at) => (Date.now() - Date.parse(at)) / 1000;
