// The first minutes: what there is to do, in order, with what is done ticked off.

import { address, requestJson } from "../api.js";
import { byId, el, showError } from "../dom.js";
import { turns } from "../turns.js";
import { currentVenue, openVenueDialog } from "../venues.js";

const turn = turns();

/** Take away the steps of the venue before. */
export function forgetSteps() {
  turn();
  for (const id of ["steps", "start-links"]) byId(id).replaceChildren();
}

/** Show the steps for the chosen venue, or for a server without any. */
export async function showSteps(floors) {
  const isLatest = turn();
  try {
    const venue = currentVenue();
    const done = await progress(venue, floors);
    const code = await phoneCode();
    if (!isLatest()) return;
    const next = done.findIndex((isDone) => !isDone);
    byId("steps").replaceChildren(...steps(venue).map((step, i) => entry(step, done[i], i === next)));
    const links = [];
    if (done[1]) links.push(el("a", { class: "button", href: `go/${encodeURIComponent(venue.id)}` }, "Open the phone page"));
    byId("start-links").replaceChildren(...links, ...code);
  } catch (error) {
    if (isLatest()) showError(byId("page-error"), error);
  }
}

/** Return the code of the server's address for phones, where it serves https. */
async function phoneCode() {
  const { https } = await requestJson("assets/addresses");
  if (!https) return [];
  const code = el("img", { src: address(`assets/qr.svg?text=${encodeURIComponent(https)}`), alt: `QR code of ${https}`, class: "code" });
  const trust = el("a", { href: address("ca.crt") }, "the certificate that phones have to trust");
  return [el("figure", { class: "card share" }, code, el("figcaption", {}, `This server for phones: ${https} (`, trust, ")"))];
}

function steps(venue) {
  const add = el("button", { type: "button", class: "small", on: { click: openVenueDialog } }, "Add a venue");
  const link = (href, words) => el("a", { href }, words);
  return [
    ["Add a venue", venue ? `${venue.name} is chosen.` : "A building, or a part of one, under one name.", venue ? null : add],
    ["Scan it", "Film it with a phone's browser, or with a scanning app whose export you drop here.", link("#scan", "Upload a scan")],
    ["Show its plan", "A picture of the floor plan; two clicks tell its scale.", link("#plan", "Upload a plan")],
    ["Lay the scan over the plan", "Drag it there, then click a few pairs of points.", link("#align", "Align")],
    ["Draw places and ways", "Landmarks to go to, and links that can be walked.", link("#draw", "Draw")],
    ["Try a photo", "See whether it is found, and by what.", link("#try", "Try a photo")],
    ["Hold up the QR code", "Any phone's browser then shows where it is, and says the way.", link("#share", "Show the code")],
  ];
}

async function progress(venue, floors) {
  if (!venue) return [false, false, false, false, false, false, false];
  const { all } = floors;
  const collections = await Promise.all(all.map((floor) => requestJson(`${floors.pathOf(floor)}/features`)));
  const kinds = new Set(collections.flatMap(({ features }) => features.map(({ properties }) => properties.kind)));
  const isPlaced = all.some((floor) => floor.plan_from_world);
  const tried = sessionStorage.getItem(`roomfix.tried.${venue.id}`) !== null;
  const shared = sessionStorage.getItem(`roomfix.shared.${venue.id}`) !== null;
  return [true, venue.map_version !== null, all.some((floor) => floor.plan), isPlaced, kinds.has("landmark") && kinds.has("link"), tried, shared];
}

function entry([title, words, action], isDone, isNext) {
  const mark = el("span", { class: "tick", "aria-hidden": "true" }, isDone ? "✓" : "");
  const state = el("span", { class: "visually-hidden" }, isDone ? "Done: " : "To do: ");
  const text = el("div", {}, el("strong", {}, state, title), el("p", { class: "help" }, words), action);
  return el("li", { class: isDone ? "done" : isNext ? "next" : null }, mark, text);
}
