// Scans: upload, progress, report with pictures, what the examination found, repair; and the versions of the map.

import { path, request, requestJson } from "../api.js";
import { Progress, endedBuild } from "../builds.js";
import { byId, el, guarded, notice, showError } from "../dom.js";
import { uploadScan } from "../scan-upload.js";
import { turns } from "../turns.js";
import { currentVenue, loadVenues } from "../venues.js";
import { count, metres, moment } from "../words.js";
import { Compare } from "./compare.js";
import { showLeftOut } from "./left-out.js";

const RUNNING = ["queued", "running"];
const PICTURE_PX = 640;

export class Scans {
  constructor(onChange) {
    Object.assign(this, { onChange, turn: turns() });
    this.progress = new Progress(byId("progress"), () => this.ended());
    this.urls = [];
    // Ends the pictures that are on their way: of a version that is deleted there will be none.
    this.pictures = new AbortController();
    this.compare = new Compare();
    byId("scan-form").addEventListener("submit", (event) => {
      event.preventDefault();
      guarded(byId("upload"), byId("scan-error"), () => this.build());
    });
  }

  /** Take away what is shown of a venue: its buttons would be taken for those of the next one. */
  forget() {
    this.turn();
    for (const id of ["versions", "versions-error", "builds", "report", "scan-error"]) byId(id).replaceChildren();
    this.compare.show([]);
  }

  async show() {
    this.forget();
    const isLatest = this.turn();
    const venue = currentVenue();
    byId("upload").disabled = venue === null || this.progress.uploading;
    if (!venue) return byId("versions").replaceChildren(notice("info", "Add a venue first, with the plus sign above."));
    try {
      const [maps, builds] = await Promise.all([
        requestJson(path("venues", venue.id, "maps")),
        requestJson(`database/builds?venue=${encodeURIComponent(venue.id)}`),
      ]);
      if (!isLatest()) return undefined;
      for (const url of this.urls.splice(0)) URL.revokeObjectURL(url);
      this.pictures.abort();
      this.pictures = new AbortController();
      const none = notice("info", "No map yet. Upload a scan to build one.");
      byId("versions").replaceChildren(...(maps.length ? maps.map((map) => this.versionCard(venue, map)) : [none]));
      this.compare.show(maps, venue);
      this.progress.follow(builds.find((one) => RUNNING.includes(one.state)) ?? null, venue.id);
      this.report(builds[0], venue, maps);
      const failed = builds.slice(1).filter((one) => one.state === "failed").slice(0, 3);
      byId("builds").replaceChildren(...failed.map(endedBuild));
    } catch (error) {
      if (isLatest()) showError(byId("versions"), error);
    }
    return undefined;
  }

  async ended() {
    await loadVenues(currentVenue()?.id);
    await this.show();
    this.onChange();
  }

  async build(more = {}) {
    const archive = byId("archive").files[0];
    const venue = currentVenue().id;
    const options = { ...this.options(), ...more };
    const submitted = await this.progress.upload((onProgress, signal) => uploadScan(archive, venue, options, onProgress, signal));
    // Another venue is shown by now, whose own build may run.
    if (currentVenue()?.id !== venue) return this.show();
    byId("report").replaceChildren();
    return this.progress.follow({ build: submitted.build, state: "queued", stage: null, done: 0, total: 0 }, venue);
  }

  options() {
    const values = {};
    if (byId("extend").checked) values.mode = "extend";
    if (byId("repair").checked) values.repair = true;
    const text = byId("scan-options").value.trim();
    if (!text) return values;
    try {
      return { ...values, ...JSON.parse(text) };
    } catch (error) {
      throw new Error(`The build options are not JSON: ${error.message}`);
    }
  }

  /** Show what came of the newest build of a venue, whose versions are `maps`. */
  report(build, venue, maps) {
    if (!build || RUNNING.includes(build.state)) return;
    const place = byId("report");
    if (build.state === "failed") {
      place.replaceChildren(el("section", { class: "card" }, el("h2", {}, "The scan was refused"), el("p", {}, build.error), this.repairButton(build)));
      return;
    }
    if (build.state !== "succeeded") return;
    const { report } = build;
    const lines = [];
    const check = report.self_check;
    lines.push(`${count(report.keyframes)} keyframes from ${count(report.frames)} frames.`);
    if (check?.tried) lines.push(`${check.located} of ${check.tried} of its own frames are located in it, typically ${metres(check.median_position_m ?? 0)} off.`);
    const examined = report.examination;
    const verdicts = {
      confirmed: "Pictures, depth and poses agree with each other.",
      doubtful: "Something about the scan is doubtful:",
      unknown: "The pictures share too little to examine the scan.",
    };
    if (examined) lines.push(verdicts[examined.verdict] ?? "");
    const repairs = report.repaired ? [notice("good", `Repaired: ${report.repaired}`)] : [];
    const warnings = (report.warnings ?? []).map((words) => notice("info", words));
    const title = el("h2", {}, `Report on version ${build.map_version}`);
    const leftOut = el("div", { class: "left-out" });
    place.replaceChildren(el("section", { class: "card" }, title, ...lines.map((line) => el("p", {}, line)), ...repairs, ...warnings, leftOut));
    // The version may have been deleted since.
    if (!maps.some(({ version }) => version === build.map_version)) return;
    showLeftOut(leftOut, venue, build.map_version, this.urls, this.pictures.signal).catch((error) => {
      if (error.name !== "AbortError") showError(leftOut, error);
    });
  }

  repairButton(build) {
    if (!/"repair": true/.test(build.error ?? "")) return null;
    const error = el("div", { role: "alert" });
    const button = el("button", { type: "button", class: "primary" }, "Repair and build again");
    button.addEventListener("click", () =>
      guarded(button, error, () => {
        if (!byId("archive").files.length) throw new Error("Choose the scan's archive again above, then press this button.");
        return this.build({ repair: true });
      }),
    );
    return el("div", {}, button, error);
  }

  versionCard(venue, map) {
    const where = path("venues", venue.id, "maps", String(map.version));
    const error = byId("versions-error");
    const title = el("h2", {}, `Version ${map.version}`);
    const head = el("div", { class: "map-head" }, title, map.active ? el("span", { class: "tag" }, "Serving") : null);
    head.append(el("time", { datetime: map.created_at }, moment(map.created_at)));
    if (!map.active) head.append(this.activateButton(where, error), this.deleteButton(map, where, error));
    const picture = el("img", { class: "top-view", alt: `Version ${map.version} from above: its points, and the scan's path in blue` });
    request(`${where}/map.png?width=${PICTURE_PX}`, { signal: this.pictures.signal })
      .then((response) => response.blob())
      .then((blob) => {
        picture.src = URL.createObjectURL(blob);
        this.urls.push(picture.src);
      })
      .catch(() => picture.remove());
    const { statistics } = map;
    const figures = `${count(statistics.map_keyframes ?? statistics.keyframes)} keyframes, ${count(statistics.features ?? 0)} features`;
    const ply = el("button", { type: "button", class: "small" }, "Points as PLY");
    ply.addEventListener("click", () => guarded(ply, error, () => this.download(where, `${venue.id}-${map.version}.ply`)));
    const card = el("section", { class: map.active ? "card map active" : "card map" }, head, el("p", { class: "help" }, figures), picture);
    card.append(el("div", { class: "actions" }, ply));
    return card;
  }

  async download(where, name) {
    const response = await request(`${where}/points?format=ply&max_points=1000000`);
    const url = URL.createObjectURL(await response.blob());
    el("a", { href: url, download: name }).click();
    setTimeout(() => URL.revokeObjectURL(url), 10_000);
  }

  activateButton(where, error) {
    const button = el("button", { type: "button", class: "small" }, "Serve this one");
    button.addEventListener("click", () =>
      guarded(button, error, async () => {
        await request(`${where}/activate`, { method: "POST" });
        await this.ended();
      }),
    );
    return button;
  }

  deleteButton(map, where, error) {
    const button = el("button", { type: "button", class: "small danger" }, "Delete");
    button.addEventListener("click", () => {
      if (!confirm(`Delete version ${map.version}? It can't be brought back.`)) return;
      guarded(button, error, async () => {
        this.pictures.abort();
        await request(where, { method: "DELETE" });
        await this.ended();
      });
    });
    return button;
  }
}
