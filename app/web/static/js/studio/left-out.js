// Frames that a build left out of a scan: how many, why, what helps, and pictures of some of them.

import { path, request, requestJson } from "../api.js";
import { el } from "../dom.js";
import { count } from "../words.js";

// By reason of the server: what is said of one frame and of several, and what helps.
const REASONS = {
  blurred: ["is blurred", "are blurred", "Move and turn more slowly there, or with more light."],
  badly_exposed: [
    "shows hardly anything",
    "show hardly anything",
    "They are too dark, too bright, or show a bare wall. Switch the light on, and aim at things with detail.",
  ],
  poor_image: [
    "shows hardly anything",
    "show hardly anything",
    "They are too dark, too bright, or show a bare wall. Switch the light on, and aim at things with detail.",
  ],
  no_depth: ["has no depth", "have no depth", "The depth sensor gave no image at that time, or the export left it out."],
  no_pose: ["has no pose", "have no pose", "The app had lost its place there. Move more slowly, and look at things with detail."],
  invalid_pose: ["has an impossible pose", "have an impossible pose", "The scanning app wrote numbers that are no pose. Export the scan again."],
  missing_file: ["is missing in the archive", "are missing in the archive", "The scan's list names files that are not there. Export the scan again, whole."],
  unreadable_file: ["can't be read", "can't be read", "Files are damaged or cut short. Export or upload the scan again."],
  unconnected: [
    "could not be connected with the others",
    "could not be connected with the others",
    "Nothing in them was recognized elsewhere. Film more slowly there, and come back to places that you have passed.",
  ],
  other_size: ["has another size than most", "have another size than most", "Take all photos with the same camera, and hold it the same way."],
};

/** Fill `place` with what a version's build left out; nothing is shown where that is nothing. Made pictures' addresses
 * are added to `urls`; `signal` ends what is on its way. */
export async function showLeftOut(place, venue, version, urls, signal) {
  const where = path("venues", venue.id, "maps", String(version), "left-out");
  const found = await requestJson(where, { signal });
  if (found.left_out === 0) return;
  const title = el("h3", {}, headline(found));
  place.replaceChildren(title, ...replacedWords(found), ...found.groups.map((group) => groupPart(group, where, urls, signal)));
}

function headline({ frames, left_out: number }) {
  const of = frames === null ? "" : ` of ${count(frames)}`;
  return `${count(number)}${of} ${number === 1 && frames === null ? "frame" : "frames"} ${number === 1 ? "was" : "were"} left out`;
}

function replacedWords({ replaced, left_out: number }) {
  if (!replaced) return [];
  const whose = replaced < number ? `${count(replaced)} of them` : number === 1 ? "it" : "each of them";
  return [el("p", { class: "help" }, `In place of ${whose} a good frame from beside it was taken.`)];
}

function groupPart({ reason, frames, names, pictures }, where, urls, signal) {
  const [one, several, help] = REASONS[reason] ?? Array(2).fill(reason.replaceAll("_", " "));
  const words = `${count(frames)} ${frames === 1 ? one : several}`;
  const strip = el("ul", { class: "strip" }, ...pictures.map((each) => pictureItem(each, several, where, urls, signal)));
  const part = el("section", { class: "left-out-group" }, el("h4", {}, words), help ? el("p", { class: "help" }, help) : null);
  if (pictures.length) part.append(strip);
  if (frames > pictures.length) part.append(nameList(frames, names));
  return part;
}

function pictureItem({ picture, name, time_s: time }, words, where, urls, signal) {
  const image = el("img", { alt: `Frame ${name}: ${words}` });
  request(`${where}/${picture}`, { signal })
    .then((response) => response.blob())
    .then((blob) => {
      image.src = URL.createObjectURL(blob);
      urls.push(image.src);
    })
    .catch(() => image.remove());
  // The folder is the same for all of them.
  const label = el("span", { class: "name", title: name }, name.split("/").at(-1));
  return el("li", {}, el("figure", {}, image, el("figcaption", {}, time === null ? null : el("strong", {}, clock(time)), label)));
}

function nameList(frames, names) {
  if (!names.length) return "";
  const summary = names.length < frames ? `Names of the first ${count(names.length)}` : "All names";
  // In the order of Tab, since a long list scrolls.
  const list = el("ul", { class: "names", tabindex: 0, "aria-label": summary }, ...names.map((name) => el("li", {}, name)));
  return el("details", {}, el("summary", {}, summary), list);
}

/** Return a time since the scan's start as minutes and seconds. */
function clock(seconds) {
  const whole = Math.floor(seconds);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}
