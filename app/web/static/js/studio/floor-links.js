// Ways between floors: stairs, lifts and escalators from a point of the shown floor to a landmark of another one.

import { requestJson } from "../api.js";
import { byId, el } from "../dom.js";

const ACCESSIBLE = { stairs: false, lift: true, escalator: false };

export class FloorLinks {
  /** `onChange(change)` is called with what alters the chosen link's properties. */
  constructor(floors, onChange) {
    Object.assign(this, { floors, onChange, landmarks: new Map() });
    byId("link-mode").addEventListener("change", () => this.change({ mode: byId("link-mode").value, accessible: undefined }));
    byId("link-floor").addEventListener("change", () => this.toFloor(byId("link-floor").value));
    byId("link-to").addEventListener("change", () => this.change({ to: byId("link-to").value }));
    byId("link-one-way").addEventListener("change", () => this.change({ one_way: byId("link-one-way").checked || undefined }));
    byId("link-accessible").addEventListener("change", () => this.change({ accessible: byId("link-accessible").checked }));
  }

  /** Return the landmarks of the other floors, by floor. */
  async read() {
    const others = this.others();
    const collections = await Promise.all(others.map((floor) => requestJson(`${this.floors.pathOf(floor)}/features`)));
    const found = collections.map(({ features }) => features.filter(({ properties }) => properties.kind === "landmark"));
    return new Map(others.map((floor, i) => [floor.id, found[i]]));
  }

  others() {
    return this.floors.all.filter((floor) => floor.id !== this.floors.current?.id);
  }

  /** Return why no way can begin here, null where one can. */
  refusal() {
    if (!this.others().length) return "Add another floor first.";
    return [...this.landmarks.values()].some((found) => found.length) ? null : "Draw a landmark on another floor first, where the way arrives.";
  }

  /** Return the properties of a new way that begins at a point: stairs to the nearest landmark of another floor. */
  propertiesAt([x, y]) {
    let [best, found] = [Infinity, null];
    for (const [floor, landmarks] of this.landmarks) {
      for (const { id, geometry } of landmarks) {
        const distance = Math.hypot(geometry.coordinates[0] - x, geometry.coordinates[1] - y);
        if (distance < best) [best, found] = [distance, { kind: "link", mode: "stairs", to_floor: floor, to: String(id) }];
      }
    }
    return found;
  }

  /** Show the form for a link, or hide it with null. */
  show(link) {
    const shown = link !== null && link.properties.to_floor !== undefined;
    byId("link-form").hidden = !shown;
    if (!shown) return;
    const { mode, to_floor: floor, to, one_way: oneWay, accessible } = link.properties;
    byId("link-mode").value = mode;
    byId("link-floor").replaceChildren(...this.others().map(({ id, name }) => el("option", { value: id }, name)));
    byId("link-floor").value = floor;
    this.listPlaces(floor);
    byId("link-to").value = to ?? "";
    byId("link-one-way").checked = Boolean(oneWay);
    byId("link-accessible").checked = accessible ?? ACCESSIBLE[mode] ?? false;
  }

  /** Return the words that stand beside a way on the plan. */
  label({ mode, to_floor: floor }) {
    const name = this.floors.all.find(({ id }) => id === floor)?.name ?? floor;
    return `${mode} to ${name}`;
  }

  listPlaces(floor) {
    const places = this.landmarks.get(floor) ?? [];
    byId("link-to").replaceChildren(...places.map(({ id, properties }) => el("option", { value: String(id) }, properties.name)));
  }

  toFloor(floor) {
    this.listPlaces(floor);
    this.change({ to_floor: floor, to: byId("link-to").value || undefined });
  }

  change(values) {
    this.onChange((properties) => {
      Object.assign(properties, values);
      for (const [name, value] of Object.entries(values)) if (value === undefined) delete properties[name];
    });
  }
}
