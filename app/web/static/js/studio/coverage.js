// Where the map would locate a phone, drawn on the plan: at each place a sector for every direction that it may look in.

import { path, requestJson } from "../api.js";
import { byId, svg } from "../dom.js";
import { turns } from "../turns.js";
import { currentVenue } from "../venues.js";
import { count } from "../words.js";

// Of the distance to the next place; the rest keeps them apart.
const RADIUS_RATIO = 0.45;

export class CoverageLayer {
  /** `onChange` runs when it is to be drawn anew. */
  constructor(board, floors, onChange) {
    Object.assign(this, { board, floors, onChange, found: null, turn: turns() });
    byId("show-coverage").addEventListener("change", () => this.begin());
  }

  /** Read it for the shown floor, where it is wanted; says what is missing. */
  async begin() {
    const isLatest = this.turn();
    this.found = null;
    this.onChange();
    const { current, venue } = this.floors;
    const version = currentVenue()?.map_version ?? null;
    const isWanted = byId("show-coverage").checked && current !== null;
    this.say(!isWanted ? "" : version === null ? "There is no map yet: upload a scan first." : "It is being computed …");
    if (!isWanted || version === null) return;
    try {
      const where = path("venues", venue, "maps", String(version), "coverage");
      const found = await requestJson(`${where}?${new URLSearchParams({ floor: current.id })}`);
      if (!isLatest()) return;
      this.found = found;
      this.say(wordsOf(found));
      this.onChange();
    } catch (error) {
      if (isLatest()) this.say(error.message);
    }
  }

  say(words) {
    byId("coverage-words").textContent = words;
  }

  /** Return what is drawn, one shape for all places. */
  shapes() {
    if (this.found === null) return [];
    const { cells, cell_m: cellM, directions_deg: directions } = this.found;
    const half = 180 / directions.length;
    const sectors = cells.flatMap(({ x, y, covered }) =>
      directions.filter((_, i) => covered[i]).map((degrees) => {
        const corners = [degrees - half, degrees, degrees + half].map((each) => {
          const angle = (each * Math.PI) / 180;
          return [x + RADIUS_RATIO * cellM * Math.cos(angle), y + RADIUS_RATIO * cellM * Math.sin(angle)];
        });
        return `M ${[[x, y], ...corners].map((point) => this.board.units(point).join(" ")).join(" L ")} Z`;
      }),
    );
    return sectors.length ? [svg("path", { d: sectors.join(" "), class: "coverage" })] : [];
  }
}

function wordsOf({ cells, cell_m: cellM }) {
  const some = cells.filter(({ covered }) => covered.some(Boolean));
  const all = cells.filter(({ covered }) => covered.every(Boolean));
  const area = (places) => `${count(Math.round(places.length * cellM * cellM))} m²`;
  if (!some.length) return "Nowhere on this floor: scan it, or align the scan with its plan.";
  return `On ${area(some)}, on ${area(all)} of them whichever way it looks. A forecast from the scan: walk with a phone to be sure.`;
}
