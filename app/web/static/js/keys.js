// The Keys view: who may call this server, new keys and tokens, and their end.

import { path, requestJson, request } from "./api.js";
import { byId, copyButton, el, guarded, notice, showError } from "./dom.js";
import { turns } from "./turns.js";
import { currentVenue, onVenueChange } from "./venues.js";
import { moment } from "./words.js";

const DAY_S = 86_400;
const turn = turns();
const MAY = {
  locate: "locate, and make tokens",
  anchor: "push frames of monitoring cameras",
  record: "locate, and record scans in the browser",
  admin: "do everything",
};

export function setUpKeys() {
  const camera = () => {
    byId("key-camera-field").hidden = byId("key-scope").value !== "anchor";
  };
  byId("key-scope").addEventListener("change", camera);
  camera();
  onVenueChange(() => showError(byId("new-key-error"), null));
  byId("new-key-form").addEventListener("submit", (event) => {
    event.preventDefault();
    guarded(byId("make-key"), byId("new-key-error"), makeKey);
  });
}

/** List the keys, those that can be used first. */
export async function showKeys() {
  const isLatest = turn();
  const list = byId("keys-list");
  const venue = currentVenue();
  byId("key-venue").replaceChildren(el("option", { value: "" }, "All venues"));
  if (venue) byId("key-venue").append(el("option", { value: venue.id, selected: true }, venue.name));
  try {
    const keys = await requestJson("keys");
    if (!isLatest()) return;
    const ended = (key) => Number(stateOf(key) !== null);
    keys.sort((a, b) => ended(a) - ended(b) || b.created_at.localeCompare(a.created_at));
    list.replaceChildren(...(keys.length ? keys.map(keyCard) : [notice("info", "There is no key yet but the one of the settings.")]));
  } catch (error) {
    if (isLatest()) showError(list, error);
  }
}

async function makeKey() {
  const days = byId("key-days").value;
  const scope = byId("key-scope").value;
  const wanted = {
    name: byId("key-name").value,
    scope,
    venue: byId("key-venue").value || null,
    camera: (scope === "anchor" && byId("key-camera").value.trim()) || null,
    expires_in_s: days ? Number(days) * DAY_S : null,
  };
  const made = await requestJson("keys", { method: "POST", json: wanted });
  const copy = el("button", { type: "button", class: "small" }, "Copy");
  copyButton(copy, () => made.text);
  const text = el("div", { class: "code" }, el("pre", { tabindex: "0" }, made.text));
  byId("new-key").replaceChildren(notice("info", "This is the only time that the key is shown."), text, copy);
  byId("new-key-form").reset();
  byId("key-scope").dispatchEvent(new Event("change"));
  await showKeys();
}

function keyCard(key) {
  const state = stateOf(key);
  const error = el("div", { role: "alert" });
  const head = el("div", { class: "map-head" }, el("h2", {}, key.name), el("span", { class: "tag plain" }, state ?? key.scope));
  head.append(el("time", { datetime: key.created_at }, moment(key.created_at)));
  if (state === null) head.append(revokeButton(key, error));
  const where = [key.venue ? `in venue ${key.venue}` : "in all venues", key.camera && `camera ${key.camera} alone`];
  const used = key.last_used_at ? `last used ${moment(key.last_used_at)}` : "never used";
  const until = key.expires_at ? `until ${moment(key.expires_at)}` : "without an end";
  const words = [`May ${MAY[key.scope]} ${where.filter(Boolean).join(", ")}`, until, used, `made with ${key.created_by}`];
  return el("section", { class: "card map" }, head, error, el("p", { class: "help" }, `${words.join("; ")}.`));
}

function stateOf(key) {
  if (key.revoked_at) return "revoked";
  return key.expires_at && new Date(key.expires_at) < new Date() ? "expired" : null;
}

function revokeButton(key, errorPlace) {
  const button = el("button", { type: "button", class: "small danger", "aria-label": `Revoke ${key.name}` }, "Revoke");
  button.addEventListener("click", () =>
    guarded(button, errorPlace, async () => {
      await request(path("keys", key.key), { method: "DELETE" });
      await showKeys();
    }),
  );
  return button;
}
