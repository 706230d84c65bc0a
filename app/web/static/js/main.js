// Starts the page: theme, key, venues, and the views that the address's fragment chooses between.

import { setUpFloors, showFloors } from "./floors.js";
import { byId, showError } from "./dom.js";
import { setUpKey } from "./key.js";
import { setUpKeys, showKeys } from "./keys.js";
import { setUpLocate } from "./locate.js";
import { setUpMaps, showMaps } from "./maps.js";
import { loadVenues, onVenueChange, setUpVenues, venuesAreKnown } from "./venues.js";

const VIEWS = { locate: () => {}, maps: showMaps, floors: showFloors, keys: showKeys };
const TITLES = { locate: "Locate", maps: "Maps", floors: "Floors", keys: "Keys" };
const THEMES = ["auto", "light", "dark"];

function currentView() {
  const name = location.hash.slice(1);
  return name in VIEWS ? name : "locate";
}

function showView() {
  const current = currentView();
  for (const name of Object.keys(VIEWS)) byId(`view-${name}`).hidden = name !== current;
  for (const link of document.querySelectorAll(".bar nav a")) {
    if (link.getAttribute("href") === `#${current}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  document.title = `${TITLES[current]} · Roomfix`;
  if (venuesAreKnown()) VIEWS[current]();
}

function setUpTheme() {
  const button = byId("theme");
  const root = document.documentElement;
  const name = () => {
    const text = `Theme: ${root.dataset.theme}`;
    button.setAttribute("aria-label", text);
    button.title = text;
  };
  button.addEventListener("click", () => {
    root.dataset.theme = THEMES[(THEMES.indexOf(root.dataset.theme) + 1) % THEMES.length];
    localStorage.setItem("roomfix.theme", root.dataset.theme);
    name();
  });
  name();
}

setUpTheme();
setUpKey();
setUpVenues();
setUpLocate();
setUpMaps();
setUpFloors();
setUpKeys();
onVenueChange(showView);
addEventListener("hashchange", () => {
  showView();
  scrollTo(0, 0);
});
// The fragment stays that of the view.
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault();
  byId("content").focus();
});
showView();
loadVenues().catch((error) => showError(byId("page-error"), error));
