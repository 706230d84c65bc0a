// The Locate view: a photo in, its place on the plan out.

import { request, requestJson } from "./api.js";
import { curlCommand } from "./curl.js";
import { byId, copyButton, el, guarded, notice, showError } from "./dom.js";
import { setUpPhoto } from "./photo.js";
import { PlanDrawing } from "./plan.js";
import { PlanTiles } from "./plan-tiles.js";
import { fieldOfView, showResult } from "./result.js";
import { currentVenue, onVenueChange, openVenueDialog, venuePath } from "./venues.js";
import { reasonWords } from "./words.js";

// Poses that are on no floor's plan are drawn in the map's own frame.
const MAP_FRAME = "";

let drawing = null;
let photo = null;
let floors = [];
let loading = Promise.resolve();
let shownFloor = null;
let selected = null;
let trail = [];
let lastNumber = 0;
// Floor, the very object, -> the address of its plan in memory.
const planUrls = new Map();

export function setUpLocate() {
  drawing = new PlanDrawing((number) => shown(select(number)));
  setUpPhoto((file) => {
    photo = file;
    showError(byId("locate-error"), null);
    updateForm();
  });
  byId("locate-form").addEventListener("submit", (event) => {
    event.preventDefault();
    guarded(byId("locate-button"), byId("locate-error"), locate);
  });
  for (const id of ["camera", "floor-hint"]) byId(id).addEventListener("input", updateForm);
  byId("clear-trail").addEventListener("click", clearTrail);
  copyButton(byId("copy-curl"), () => byId("curl").textContent);
  onVenueChange(changeVenue);
  updateForm();
}

/** Read the floors again, after the Floors view has changed them. */
export function reloadFloors() {
  loading = readFloors();
  return loading;
}

async function readFloors() {
  const venue = currentVenue();
  const found = venue ? await requestJson(venuePath("floors")) : [];
  // Another venue may have been chosen meanwhile: its floors are read by a call of its own.
  if (currentVenue()?.id !== venue?.id) return;
  for (const url of planUrls.values()) URL.revokeObjectURL(url);
  planUrls.clear();
  floors = found;
  const options = floors.map((floor) => el("option", { value: floor.id }, floor.name));
  byId("floor-hint").replaceChildren(el("option", { value: "" }, "Any floor"), ...options);
  const before = shownFloor;
  shownFloor = null;
  await showFloor(floors.some((floor) => floor.id === before) ? before : (floors[0]?.id ?? MAP_FRAME));
}

async function changeVenue() {
  floors = [];
  shownFloor = null;
  clearTrail();
  const place = byId("page-error");
  const venue = currentVenue();
  showError(place, null);
  if (!venue) place.replaceChildren(noVenue());
  try {
    await reloadFloors();
  } catch (error) {
    if (currentVenue()?.id === venue?.id) showError(place, error);
  }
  updateForm();
}

function noVenue() {
  const button = el("button", { type: "button", class: "small", on: { click: openVenueDialog } }, "Add a venue");
  const studio = el("a", { href: "studio" }, "The studio leads through all steps");
  return notice("info", "There is no venue yet. A venue is a building with one map. ", button, " ", studio);
}

function updateForm() {
  byId("locate-button").disabled = photo === null || currentVenue() === null;
  byId("curl").textContent = curlCommand(photo?.name ?? "photo.jpg", fields());
}

function fields() {
  const values = { venue: currentVenue()?.id, floor: byId("floor-hint").value, camera: byId("camera").value.trim() };
  return Object.fromEntries(Object.entries(values).filter(([, value]) => value));
}

async function locate() {
  const form = new FormData();
  // Another photo may be chosen before the answer comes.
  const sent = photo;
  form.set("image", sent, sent.name || "photo.jpg");
  for (const [name, value] of Object.entries(fields())) form.set(name, value);
  const venue = currentVenue();
  const answer = await requestJson("locate", { method: "POST", form });
  // An answer may come before the floors that it is shown on.
  await loading.catch(() => null);
  if (currentVenue()?.id !== venue.id) return;
  lastNumber += 1;
  trail.push({ number: lastNumber, answer, name: sent.name, url: URL.createObjectURL(sent) });
  await select(lastNumber);
  if (matchMedia("(max-width: 60rem)").matches) {
    const news = answer.located ? document.querySelector(".plan-card") : byId("result");
    news.scrollIntoView({ behavior: "smooth" });
  }
}

async function select(number) {
  selected = number;
  const entry = trail.find((one) => one.number === number);
  const { answer } = entry;
  showResult(entry, floors.find((floor) => floor.id === answer.floor)?.name);
  if (answer.located) await showFloor(frameOf(answer));
  else showTrail();
}

/** Say on the page what kept a floor from being shown. */
function shown(showing) {
  showing.catch((error) => showError(byId("page-error"), error));
}

function frameOf(answer) {
  return answer.plan && floors.some((floor) => floor.id === answer.floor) ? answer.floor : MAP_FRAME;
}

async function showFloor(id) {
  const changed = id !== shownFloor;
  shownFloor = id;
  const floor = floors.find((one) => one.id === id);
  try {
    if (changed) await drawGround(floor);
  } catch (error) {
    // The next attempt reads the plan again.
    if (shownFloor === id) shownFloor = null;
    throw error;
  }
  if (shownFloor !== id || (floor !== undefined && !floors.includes(floor))) return;
  showTabs();
  showTrail();
}

async function drawGround(floor) {
  const isTiled = Boolean(floor?.plan?.tiles);
  const url = floor?.plan && !isTiled ? await planUrl(floor) : null;
  // Another floor is shown by now, or one of the same id in another venue.
  if (floor !== undefined && (floor.id !== shownFloor || !floors.includes(floor))) return;
  if (isTiled) drawing.showPlan(floor.plan, null, new PlanTiles(floor.plan, venuePath("floors", floor.id, "plan")));
  else if (url) drawing.showPlan(floor.plan, url);
  else drawing.showGrid();
}

// An <img> can't send a key, so the image is fetched and shown from memory.
async function planUrl(floor) {
  if (!planUrls.has(floor)) {
    const response = await request(venuePath("floors", floor.id, "plan"));
    const url = URL.createObjectURL(await response.blob());
    if (floors.includes(floor)) planUrls.set(floor, url);
    else URL.revokeObjectURL(url);
  }
  return planUrls.get(floor) ?? null;
}

function showTabs() {
  const frames = floors.map((floor) => [floor.id, floor.name]);
  const offPlan = trail.some(({ answer }) => answer.located && frameOf(answer) === MAP_FRAME);
  if (offPlan || !floors.length) frames.push([MAP_FRAME, "Map frame"]);
  const tabs = frames.map(([id, name]) =>
    el("button", { type: "button", "aria-pressed": String(id === shownFloor), on: { click: () => shown(showFloor(id)) } }, name),
  );
  byId("floor-tabs").replaceChildren(...tabs);
}

function showTrail() {
  const onFloor = trail.filter(({ answer }) => answer.located && frameOf(answer) === shownFloor);
  drawing.showPlaces(onFloor.map(place), selected);
  byId("plan-note").textContent = onFloor.length ? "" : emptyNote();
  byId("trail").hidden = trail.length === 0;
  byId("trail-list").replaceChildren(...trail.map(trailItem));
}

function emptyNote() {
  const floor = floors.find((one) => one.id === shownFloor);
  if (!currentVenue()) return "";
  if (!floor) return "No floor plan yet: places are drawn in the map's own frame, one square a metre.";
  if (!floor.plan) return "This floor has no plan image yet: one square is a metre.";
  return trail.length ? "" : "Located photos appear here.";
}

function place({ number, answer }) {
  const at = shownFloor === MAP_FRAME ? inMapFrame(answer.pose) : answer.plan;
  const sigma = answer.accuracy?.position_m ?? 0;
  return {
    number,
    x: at.x,
    y: at.y,
    headingDeg: at.heading_deg,
    accuracyM: sigma,
    fovDeg: fieldOfView(answer.camera),
    label: `Photo ${number}`,
  };
}

// The optical axis is the camera's z axis: the third column of the pose's rotation.
function inMapFrame({ position, quaternion: { x, y, z, w } }) {
  const axis = [2 * (x * z + w * y), 2 * (y * z - w * x)];
  return { x: position.x, y: position.y, heading_deg: (Math.atan2(axis[1], axis[0]) * 180) / Math.PI };
}

function trailItem(entry) {
  const { number, answer, url, name } = entry;
  const words = answer.located ? `Photo ${number}, located` : `Photo ${number}, not located: ${reasonWords(answer.reason)[0]}`;
  const button = el(
    "button",
    {
      type: "button",
      class: answer.located ? "thumb" : "thumb missed",
      "aria-label": words,
      "aria-pressed": String(number === selected),
      title: name,
      on: { click: () => shown(select(number)) },
    },
    el("img", { src: url, alt: "" }),
    el("span", { "aria-hidden": "true" }, answer.located ? String(number) : `${number} ?`),
  );
  return el("li", {}, button);
}

function clearTrail() {
  for (const { url } of trail) URL.revokeObjectURL(url);
  trail = [];
  selected = null;
  byId("result").replaceChildren();
  showTabs();
  showTrail();
}
