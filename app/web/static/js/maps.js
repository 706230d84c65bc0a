// The Maps view: the versions of a venue's map, and builds of new ones.

import { path, requestJson } from "./api.js";
import { Progress, endedBuild } from "./builds.js";
import { byId, el, guarded, notice, showError } from "./dom.js";
import { uploadScan } from "./scan-upload.js";
import { turns } from "./turns.js";
import { currentVenue, onVenueChange, venuePath } from "./venues.js";
import { bytes, count, degrees, metres, moment, seconds } from "./words.js";

const RUNNING = ["queued", "running"];
const turn = turns();
let progress = null;

export function setUpMaps() {
  progress = new Progress(byId("progress"), showMaps);
  byId("rule").addEventListener("change", () => {
    byId("every-field").hidden = byId("rule").value !== "interval";
  });
  onVenueChange(() => {
    showError(byId("build-error"), null);
    forgetMaps();
  });
  byId("build-form").addEventListener("submit", (event) => {
    event.preventDefault();
    guarded(byId("build"), byId("build-error"), build);
  });
}

/** Take away the versions of the venue before: their buttons would be taken for those of the chosen one. */
function forgetMaps() {
  turn();
  for (const id of ["maps-list", "builds"]) byId(id).replaceChildren();
}

/** Show the chosen venue's maps and builds, and follow a build that runs. */
export async function showMaps() {
  const isLatest = turn();
  const venue = currentVenue();
  const list = byId("maps-list");
  byId("build").disabled = venue === null || progress.uploading;
  if (!venue) {
    list.replaceChildren(notice("info", "Add a venue first, with the plus sign above."));
    byId("builds").replaceChildren();
    return;
  }
  try {
    const maps = await requestJson(venuePath("maps"));
    if (!isLatest()) return;
    list.replaceChildren(...(maps.length ? maps.map((map) => mapCard(venue, map)) : [noMap()]));
    const builds = await requestJson(`database/builds?venue=${encodeURIComponent(venue.id)}`);
    if (!isLatest()) return;
    const ended = builds.filter((one) => one.state === "failed" || one.state === "cancelled").slice(0, 5);
    byId("builds").replaceChildren(...(ended.length ? [el("h2", {}, "Builds without a map"), ...ended.map(endedBuild)] : []));
    progress.follow(builds.find((one) => RUNNING.includes(one.state)) ?? null, venue.id);
  } catch (error) {
    if (isLatest()) showError(list, error);
  }
}

async function build() {
  const archive = byId("archive").files[0];
  const venue = currentVenue().id;
  const values = options();
  const submitted = await progress.upload((onProgress, signal) => uploadScan(archive, venue, values, onProgress, signal));
  byId("archive").value = "";
  // Another venue is shown by now, whose own build may run.
  if (currentVenue()?.id !== venue) return showMaps();
  return progress.follow({ build: submitted.build, state: "queued", stage: null, done: 0, total: 0 }, venue);
}

function options() {
  const values = {};
  if (byId("format").value !== "auto") values.format = byId("format").value;
  if (byId("mode").value !== "replace") values.mode = byId("mode").value;
  if (byId("features").value !== "sift") values.features = byId("features").value;
  if (byId("rule").value === "interval") values.keyframes = { rule: "interval", every: Number(byId("every").value) };
  if (byId("scan-camera").value.trim()) values.camera = byId("scan-camera").value.trim();
  if (byId("depth-scale").value) values.depth_scale = Number(byId("depth-scale").value);
  if (byId("gravity").value.trim()) values.gravity = byId("gravity").value.split(",").map(Number);
  return { ...values, ...furtherOptions() };
}

function furtherOptions() {
  const text = byId("more").value.trim();
  if (!text) return {};
  try {
    return JSON.parse(text);
  } catch (error) {
    throw new Error(`The further options are not JSON: ${error.message}`);
  }
}

function noMap() {
  return notice("info", "This venue has no map yet. Upload a scan to build one; photos can be located as soon as it is done.");
}

function mapCard(venue, map) {
  const { statistics } = map;
  const title = el("h2", {}, `Version ${map.version}`);
  const error = el("div", { role: "alert" });
  const head = el("div", { class: "map-head" }, title, map.active ? el("span", { class: "tag" }, "Serving") : null);
  head.append(el("time", { datetime: map.created_at }, moment(map.created_at)));
  if (!map.active) head.append(activateButton(venue, map, error));
  const card = el("section", { class: map.active ? "card map active" : "card map" }, head, error);
  card.append(el("div", { class: "figures" }, ...figures(statistics)));
  const code = el("div", { class: "code" }, el("pre", { tabindex: "0" }, JSON.stringify(statistics, null, 2)));
  card.append(el("details", {}, el("summary", {}, "Full report"), code));
  return card;
}

function activateButton(venue, map, errorPlace) {
  const button = el("button", { type: "button", class: "small" }, "Activate");
  button.addEventListener("click", () =>
    guarded(button, errorPlace, async () => {
      await requestJson(path("venues", venue.id, "maps", map.version, "activate"), { method: "POST" });
      await showMaps();
    }),
  );
  return button;
}

// Older reports may lack a figure that newer ones have.
function figures(statistics) {
  const { self_check: check, discarded, seconds: times, bytes: sizes } = statistics;
  const sum = (values) => Object.values(values).reduce((total, value) => total + value, 0);
  const shown = [];
  const add = (name, value, note) => shown.push(figure(name, value, note));
  const leftOut = discarded && sum(discarded) ? `; left out: ${discardWords(discarded)}` : "";
  if (statistics.map_keyframes) {
    add("Keyframes", count(statistics.map_keyframes), `from ${count(statistics.frames)} frames${leftOut}`);
  }
  if (statistics.features) add("Features", count(statistics.features), statistics.feature_method);
  if (check?.tried) add("Self-check", `${check.located} of ${check.tried}`, "frames of the scan located");
  if (check?.median_position_m != null) {
    add("Median error", metres(check.median_position_m), degrees(check.median_orientation_deg, 2));
  }
  if (sizes) add("Size", bytes(sum(sizes)));
  if (times) add("Build time", seconds(sum(times)));
  return shown;
}

function discardWords(discarded) {
  const reasons = Object.entries(discarded).filter(([, number]) => number > 0);
  return reasons.map(([reason, number]) => `${count(number)} ${reason.replaceAll("_", " ")}`).join(", ");
}

function figure(name, value, note) {
  return el("div", { class: "figure" }, el("span", {}, name), el("strong", {}, value), note ? el("small", {}, note) : null);
}
