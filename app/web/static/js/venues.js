// The venue that all views work on, and the dialog that adds one.

import { path, requestJson } from "./api.js";
import { byId, el, guarded, showError } from "./dom.js";
import { turns } from "./turns.js";
import { transliterated } from "./words.js";

const REMEMBERED = "roomfix.venue";
const changes = new EventTarget();
const turn = turns();
// Null until the server's list is there.
let venues = null;

/** Run a function whenever another venue is chosen, or the list has changed. */
export function onVenueChange(run) {
  changes.addEventListener("change", run);
}

/** Whether the list of venues has been read: before that, nothing can be said of there being none. */
export const venuesAreKnown = () => venues !== null;

/** Return the chosen venue, or null when there is none. */
export function currentVenue() {
  return venues?.find((venue) => venue.id === byId("venue").value) ?? null;
}

/** Return the path of something in the chosen venue. */
export function venuePath(...parts) {
  return path("venues", currentVenue().id, ...parts);
}

/** Read the list from the server, and choose one, unless another is chosen meanwhile. */
export async function loadVenues(wanted = localStorage.getItem(REMEMBERED)) {
  const isLatest = turn();
  const select = byId("venue");
  const before = select.value;
  const found = await requestJson("venues");
  if (!isLatest()) return;
  const choice = select.value === before ? wanted : select.value;
  venues = found;
  select.replaceChildren(...venues.map((venue) => el("option", { value: venue.id }, venue.name)));
  if (!venues.length) select.append(el("option", { value: "" }, "No venue yet"));
  select.disabled = venues.length === 0;
  if (venues.some((venue) => venue.id === choice)) select.value = choice;
  changes.dispatchEvent(new Event("change"));
}

export function setUpVenues() {
  const dialog = byId("venue-dialog");
  byId("venue").addEventListener("change", () => {
    localStorage.setItem(REMEMBERED, byId("venue").value);
    changes.dispatchEvent(new Event("change"));
  });
  byId("new-venue").addEventListener("click", openVenueDialog);
  byId("venue-cancel").addEventListener("click", () => dialog.close());
  byId("venue-name").addEventListener("input", suggestId);
  byId("venue-id").addEventListener("input", () => {
    byId("venue-id").dataset.typed = "yes";
  });
  byId("venue-form").addEventListener("submit", (event) => {
    event.preventDefault();
    guarded(event.submitter, byId("venue-error"), async () => {
      const body = { id: byId("venue-id").value, name: byId("venue-name").value };
      const created = await requestJson("venues", { method: "POST", json: body });
      dialog.close();
      localStorage.setItem(REMEMBERED, created.id);
      await loadVenues(created.id);
    });
  });
}

/** Open the dialog that adds a venue. */
export function openVenueDialog() {
  byId("venue-form").reset();
  byId("venue-id").dataset.typed = "";
  showError(byId("venue-error"), null);
  byId("venue-dialog").showModal();
}

function suggestId() {
  const field = byId("venue-id");
  if (field.dataset.typed) return;
  const words = transliterated(byId("venue-name").value).toLowerCase();
  field.value = words.replace(/[^a-z0-9]+/g, "-").replace(/^-+|-+$/g, "").slice(0, 64);
}
