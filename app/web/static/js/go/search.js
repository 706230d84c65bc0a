// The dialog in which a destination is searched by its words.

import { path, requestJson } from "../api.js";
import { byId, el } from "../dom.js";
import { turns } from "../turns.js";
import { language, say } from "./words.js";

const SHOWN = 60;

export class Search {
  /** `onChoose` gets `{id, name}` of the place that was chosen. */
  constructor(venue, onChoose) {
    this.venue = venue;
    this.onChoose = onChoose;
    this.places = null;
    this.turn = turns();
    this.dialog = byId("search-dialog");
    byId("query").addEventListener("input", () => this.list());
    byId("query").addEventListener("keydown", (event) => {
      if (event.key !== "Enter") return;
      // Else the key also presses the button that the focus goes back to, which opens the dialog again.
      event.preventDefault();
      byId("places").querySelector("button")?.click();
    });
    byId("search-close").addEventListener("click", () => this.dialog.close());
  }

  /** Open the dialog; the places are read when it is opened first. `floors()` resolves to the floors of the venue. */
  async open(floors) {
    const isLatest = this.turn();
    byId("query").value = "";
    this.dialog.showModal();
    this.list();
    if (this.places) return;
    try {
      const places = await this.read(await floors());
      this.places ??= places;
      this.list();
    } catch (error) {
      // They are read anew when the dialog is opened again.
      if (isLatest()) byId("found").textContent = error.message;
    }
  }

  async read(floors) {
    const collections = await Promise.all(
      floors.map((floor) => requestJson(path("venues", this.venue, "floors", floor.id, "features"))),
    );
    const places = collections.flatMap((collection, i) =>
      collection.features
        .filter(({ properties }) => properties.kind === "landmark" || properties.kind === "poi")
        .map(({ id, properties }) => ({ id: String(id ?? properties.id), name: properties.name, floor: floors[i] })),
    );
    const count = (id) => places.filter((place) => place.id === id).length;
    for (const place of places) if (count(place.id) > 1) place.id = `${place.floor.id}:${place.id}`;
    return places;
  }

  list() {
    if (this.places === null) {
      // Nothing can be said of what there is before it is known.
      byId("found").textContent = say("search.loading");
      byId("places").replaceChildren();
      return;
    }
    const words = plain(byId("query").value).split(/\s+/).filter(Boolean);
    const found = this.places
      .map((place) => ({ ...place, rank: rank(plain(place.name), words) }))
      .filter((place) => place.rank !== null)
      .sort((a, b) => a.rank - b.rank || a.name.localeCompare(b.name, language(), { numeric: true }));
    byId("found").textContent = found.length ? say("search.found", { count: found.length }) : say("search.none");
    byId("places").replaceChildren(...found.slice(0, SHOWN).map((place) => this.entry(place)));
  }

  entry(place) {
    const choose = () => {
      this.dialog.close();
      this.onChoose(place);
    };
    const floor = el("span", { class: "place-floor" }, place.floor.name);
    return el("li", {}, el("button", { type: "button", on: { click: choose } }, el("span", {}, place.name), " ", floor));
  }
}

/** Return text without accents and capitals, so that "cafe" finds "Café". */
function plain(text) {
  return text.normalize("NFKD").replace(/\p{M}/gu, "").toLowerCase().trim();
}

/** Return null unless all words begin a word of the name; less is better: the name itself, its beginning, elsewhere. */
function rank(name, words) {
  const parts = name.split(/[^\p{L}\p{N}]+/u);
  if (!words.every((word) => parts.some((part) => part.startsWith(word)))) return null;
  const asked = words.join(" ");
  if (name === asked) return 0;
  return name.startsWith(asked) ? 1 + name.length / 1000 : 2 + name.length / 1000;
}
