// The QR code that opens the phone page of the venue.

import { ApiError, address, path, request, requestJson, storedKey } from "../api.js";
import { byId, showError } from "../dom.js";
import { currentVenue } from "../venues.js";

const REMEMBERED = "roomfix.address";
let shown = null;

export function setUpShare() {
  byId("address").addEventListener("change", () => {
    localStorage.setItem(REMEMBERED, byId("address").value);
    showShare();
  });
  byId("print").addEventListener("click", () => print());
}

/** Show the code for the chosen venue. */
export async function showShare() {
  const venue = currentVenue();
  showError(byId("share-error"), null);
  byId("qr").hidden = true;
  if (!venue) return showError(byId("share-error"), new Error("Add a venue first, with the plus sign above."));
  const base = byId("address").value || localStorage.getItem(REMEMBERED) || (await phoneAddress());
  byId("address").value = base;
  try {
    const link = await linkTo(base, venue.id);
    const response = await request(`assets/qr.svg?text=${encodeURIComponent(link)}`);
    if (shown) URL.revokeObjectURL(shown);
    shown = URL.createObjectURL(await response.blob());
    Object.assign(byId("qr"), { src: shown, hidden: false, alt: `QR code of the phone page of ${venue.name}` });
    Object.assign(byId("go-link"), { href: link, textContent: link.split("#")[0] });
  } catch (error) {
    showError(byId("share-error"), error);
  }
  return undefined;
}

/** The address that phones reach this server at, as the server knows it; else the one of this page. */
async function phoneAddress() {
  const { https } = await requestJson("assets/addresses").catch(() => ({ https: null }));
  return https ?? address("");
}

/** Return the link of the phone page; where the server asks for keys it carries a short-lived token in its fragment. */
async function linkTo(base, venue) {
  const link = new URL(path("go", venue), base.endsWith("/") ? base : `${base}/`);
  if (storedKey.get() === null) return link.href;
  try {
    const { token } = await requestJson("tokens", { method: "POST", json: { venue } });
    return `${link.href}#token=${encodeURIComponent(token)}`;
  } catch (error) {
    // A server without tokens: the phone page asks for a key by itself.
    if (error instanceof ApiError && error.status === 404) return link.href;
    throw error;
  }
}
