// The QR code that opens the phone page of the venue with a key that may only locate there, or the page that records.

import { address, path, request, requestJson } from "../api.js";
import { byId, guarded, showError } from "../dom.js";
import { turns } from "../turns.js";
import { currentVenue } from "../venues.js";

const REMEMBERED = "roomfix.address";
const DAY_S = 86_400;
const turn = turns();
let shown = null;

export function setUpShare() {
  byId("address").addEventListener("change", () => localStorage.setItem(REMEMBERED, byId("address").value));
  for (const id of ["address", "purpose", "validity"]) byId(id).addEventListener("change", forgetCode);
  byId("make-code").addEventListener("click", (event) => guarded(event.target, byId("share-error"), makeCode));
  byId("print").addEventListener("click", () => print());
}

/** Show the form for the chosen venue, without a code. */
export async function showShare() {
  showError(byId("share-error"), null);
  forgetCode();
  byId("make-code").disabled = currentVenue() === null;
  if (!currentVenue()) showError(byId("share-error"), new Error("Add a venue first, with the plus sign above."));
  const known = localStorage.getItem(REMEMBERED) ?? (await phoneAddress());
  // What was typed meanwhile stays.
  byId("address").value ||= known;
}

/** Ask for a code to record with. */
export function chooseRecording() {
  byId("purpose").value = "record";
  forgetCode();
}

/** Take the code away: it is not of what is chosen now. One that is being made is not shown. */
export function forgetCode() {
  turn();
  byId("qr").hidden = true;
  // Without a code there is nothing to print.
  byId("print").hidden = true;
  byId("go-link").textContent = "";
  const records = byId("purpose").value === "record";
  byId("validity").disabled = records;
  byId("purpose-help").textContent = records
    ? "Valid for a day, and only for whoever films: the map of a recording replaces the present one."
    : "";
}

async function makeCode() {
  const isLatest = turn();
  const venue = currentVenue();
  const records = byId("purpose").value === "record";
  const link = await linkTo(byId("address").value, venue.id, records);
  const response = await request(`assets/qr.svg?text=${encodeURIComponent(link)}`);
  const picture = await response.blob();
  if (!isLatest()) return;
  if (shown) URL.revokeObjectURL(shown);
  shown = URL.createObjectURL(picture);
  Object.assign(byId("qr"), { src: shown, hidden: false, alt: `QR code of the ${records ? "recording" : "phone"} page of ${venue.name}` });
  byId("print").hidden = false;
  Object.assign(byId("go-link"), { href: link, textContent: link.split("#")[0] });
  if (!records) sessionStorage.setItem(`roomfix.shared.${venue.id}`, "yes");
}

/** The address that phones reach this server at, as the server knows it; else the one of this page. */
async function phoneAddress() {
  const { https } = await requestJson("assets/addresses").catch(() => ({ https: null }));
  return https ?? address("");
}

/** Return the link of the phone page, or of the page that records. What lets the phone in stands in the fragment, which is never sent. */
async function linkTo(base, venue, records) {
  const link = new URL(path(records ? "record" : "go", venue), base.endsWith("/") ? base : `${base}/`);
  const scope = records ? "record" : "locate";
  const made =
    records || byId("validity").value === "day"
      ? (await requestJson("tokens", { method: "POST", json: { venue, expires_in_s: DAY_S, scope } })).token
      : (await requestJson("keys", { method: "POST", json: { name: "QR code", scope: "locate", venue } })).text;
  return `${link.href}#token=${encodeURIComponent(made)}`;
}
