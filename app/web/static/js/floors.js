// The Floors view: floors, and the plan image of each.

import { path, request, requestJson } from "./api.js";
import { byId, el, guarded, notice, showError } from "./dom.js";
import { reloadFloors } from "./locate.js";
import { PlanPicker } from "./plan-picker.js";
import { turns } from "./turns.js";
import { currentVenue, onVenueChange, venuePath } from "./venues.js";
import { metres } from "./words.js";

const turn = turns();
let picker = null;
let thumbnails = [];

export function setUpFloors() {
  picker = new PlanPicker();
  onVenueChange(forgetFloors);
  byId("floor-form").addEventListener("submit", (event) => {
    event.preventDefault();
    guarded(event.submitter, byId("floor-error"), saveFloor);
  });
  byId("plan-form").addEventListener("submit", (event) => {
    event.preventDefault();
    guarded(event.submitter, byId("plan-error"), uploadPlan);
  });
  byId("same-axes").addEventListener("click", () => {
    byId("plan-from-world").value = matrixText([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
  });
}

/** Take away the floors of the venue before: their buttons and names would be taken for those of the chosen one. */
function forgetFloors() {
  turn();
  byId("floors-list").replaceChildren();
  byId("plan-floor").replaceChildren();
  for (const id of ["floor-error", "plan-error"]) showError(byId(id), null);
}

/** Show the chosen venue's floors. */
export async function showFloors() {
  const isLatest = turn();
  const list = byId("floors-list");
  for (const id of ["floor-form", "plan-form"]) byId(id).inert = currentVenue() === null;
  const venue = currentVenue();
  if (!venue) {
    list.replaceChildren(notice("info", "Add a venue first, with the plus sign above."));
    return;
  }
  try {
    const floors = await requestJson(venuePath("floors"));
    if (!isLatest()) return;
    for (const url of thumbnails) URL.revokeObjectURL(url);
    thumbnails = [];
    list.replaceChildren(...(floors.length ? floors.map((floor) => floorCard(venue, floor)) : [noFloor()]));
    const before = byId("plan-floor").value;
    byId("plan-floor").replaceChildren(...floors.map((floor) => el("option", { value: floor.id }, floor.name)));
    if (floors.some((floor) => floor.id === before)) byId("plan-floor").value = before;
  } catch (error) {
    if (isLatest()) showError(list, error);
  }
}

function noFloor() {
  return notice("info", "This venue has no floors yet. Photos can be located without them, but not on a plan.");
}

function floorCard(venue, floor) {
  const { plan } = floor;
  const error = el("div", { role: "alert" });
  const edit = el("button", { type: "button", class: "small", on: { click: () => editFloor(floor) } }, "Edit");
  const remove = el("button", { type: "button", class: "small danger" }, "Delete");
  remove.addEventListener("click", () => {
    if (confirm(`Delete the floor ${floor.name} with its plan?`)) guarded(remove, error, () => deleteFloor(venue, floor));
  });
  const head = el("div", { class: "map-head" }, el("h2", {}, floor.name), el("span", { class: "tag plain" }, floor.id), edit, remove);
  const rows = [
    ["Level", String(floor.level)],
    ["Heights", `${floor.z_min_m} m to ${floor.z_max_m} m`],
    ["Plan from world", placement(floor)],
    ["Plan image", plan ? `${plan.width_px} × ${plan.height_px} px, ${plan.meters_per_pixel} m per pixel` : "none yet"],
  ];
  const table = el("dl", { class: "rows" }, ...rows.map(([name, value]) => el("div", {}, el("dt", {}, name), el("dd", {}, value))));
  const body = el("div", { class: "floor-body" }, table);
  if (plan) body.prepend(thumbnail(floor));
  return el("section", { class: "card" }, head, error, body);
}

function placement({ plan_from_world: matrix, plan_residual_m: residual }) {
  if (!matrix) return "not set: positions are known in the map only";
  return residual === null ? "given as a matrix" : `fitted to points, ${metres(residual)} off (RMS)`;
}

function thumbnail(floor) {
  const image = el("img", { class: "plan-thumb", alt: `Plan of ${floor.name}` });
  request(venuePath("floors", floor.id, "plan"))
    .then((response) => response.blob())
    .then((blob) => {
      image.src = URL.createObjectURL(blob);
      thumbnails.push(image.src);
    })
    .catch(() => image.remove());
  return image;
}

function editFloor(floor) {
  const values = {
    "floor-id": floor.id,
    "floor-name": floor.name,
    level: floor.level,
    "z-min": floor.z_min_m,
    "z-max": floor.z_max_m,
    "plan-from-world": floor.plan_from_world ? matrixText(floor.plan_from_world) : "",
    "plan-floor": floor.id,
  };
  for (const [id, value] of Object.entries(values)) byId(id).value = value;
  byId("floor-name").focus();
}

async function deleteFloor(venue, floor) {
  await request(path("venues", venue.id, "floors", floor.id), { method: "DELETE" });
  await changed();
}

async function saveFloor() {
  const body = {
    name: byId("floor-name").value,
    level: Number(byId("level").value),
    z_min_m: Number(byId("z-min").value),
    z_max_m: Number(byId("z-max").value),
    plan_from_world: planFromWorld(),
  };
  const id = byId("floor-id").value;
  const venue = currentVenue();
  await requestJson(venuePath("floors", id), { method: "PUT", json: body });
  if (currentVenue()?.id !== venue.id) return;
  byId("floor-error").replaceChildren(notice("good", "Saved."));
  await changed();
  if (currentVenue()?.id === venue.id) byId("plan-floor").value = id;
}

function planFromWorld() {
  const text = byId("plan-from-world").value.trim();
  if (!text) return null;
  try {
    return JSON.parse(text);
  } catch (error) {
    throw new Error(`Plan from world is not JSON: ${error.message}`);
  }
}

async function uploadPlan() {
  const form = new FormData();
  const image = byId("plan-image").files[0];
  form.set("image", image, image.name);
  form.set("meters_per_pixel", byId("meters-per-pixel").value);
  form.set("origin_px", byId("origin").value);
  const venue = currentVenue();
  await requestJson(venuePath("floors", byId("plan-floor").value, "plan"), { method: "PUT", form });
  if (currentVenue()?.id !== venue.id) return;
  byId("plan-form").reset();
  picker.clear();
  byId("plan-error").replaceChildren(notice("good", "The plan is stored."));
  await changed();
}

async function changed() {
  await Promise.all([showFloors(), reloadFloors()]);
}

function matrixText(matrix) {
  return `[${matrix.map((row) => JSON.stringify(row)).join(",\n ")}]`;
}
