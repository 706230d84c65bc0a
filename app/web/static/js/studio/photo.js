// A photo located, with the matches that speak for the place drawn between it and the keyframe that shares most.

import { path, request, requestJson } from "../api.js";
import { byId, el, guarded, notice, showError, svg } from "../dom.js";
import { turns } from "../turns.js";
import { currentVenue } from "../venues.js";
import { metres, reasonWords } from "../words.js";

const MAX_LINES = 150;
const GAP_SHARE = 0.03;
const turn = turns();

/** `floors` has the names of the venue's floors. */
export function setUpPhoto(floors) {
  byId("try-form").addEventListener("submit", (event) => {
    event.preventDefault();
    guarded(byId("try"), byId("try-error"), () => locate(floors));
  });
}

/** Take away what was found in the venue before. */
export function forgetPhoto() {
  turn();
  byId("try-result").replaceChildren();
  showError(byId("try-error"), null);
}

async function locate(floors) {
  const isLatest = turn();
  const venue = currentVenue();
  if (!venue) throw new Error("Add a venue first, with the plus sign above.");
  const photo = byId("photo").files[0];
  const form = new FormData();
  form.set("venue", venue.id);
  form.set("image", photo, photo.name);
  form.set("matches", "true");
  const camera = byId("photo-camera").value.trim();
  if (camera) form.set("camera", camera);
  const answer = await requestJson("locate", { method: "POST", form });
  sessionStorage.setItem(`roomfix.tried.${venue.id}`, "yes");
  if (!isLatest()) return;
  const place = byId("try-result");
  if (!answer.located) {
    place.replaceChildren(notice("info", ...reasonWords(answer.reason).map((words) => el("span", {}, `${words} `))));
    return;
  }
  const floor = floors.all.find(({ id }) => id === answer.floor)?.name ?? answer.floor;
  const where = answer.plan
    ? `At ${answer.plan.x.toFixed(2)}, ${answer.plan.y.toFixed(2)} m on ${floor}, looking ${Math.round(answer.plan.heading_deg)}°.`
    : "Located in the map; it has no place on a plan yet.";
  const sure = `Within ${metres(answer.accuracy.position_m)}, ${Math.round(100 * answer.confidence)} % sure. ${answer.inliers} of ${answer.matches} matches agree.`;
  place.replaceChildren(el("section", { class: "card" }, el("h2", {}, "Located"), el("p", {}, where), el("p", {}, sure)));
  if (!answer.shown_matches) return;
  const drawn = await drawing(photo, venue, answer);
  if (isLatest()) place.append(drawn);
}

async function drawing(photo, venue, answer) {
  const { keyframe, pairs } = answer.shown_matches;
  const left = await size(URL.createObjectURL(photo));
  let right = null;
  try {
    const where = path("venues", venue.id, "maps", String(answer.map_version), "keyframes", String(keyframe), "picture");
    const response = await request(where);
    right = await size(URL.createObjectURL(await response.blob()));
  } catch {
    return notice("info", "The map was built without pictures, so the matches can't be drawn.");
  }
  // Both pictures are drawn equally high.
  const scale = left.height / right.height;
  const shift = left.width * (1 + GAP_SHARE);
  const width = shift + right.width * scale;
  const step = Math.max(1, Math.ceil(pairs.length / MAX_LINES));
  const lines = pairs
    .filter((_, i) => i % step === 0)
    .map(([u, v, ku, kv]) => svg("line", { x1: u, y1: v, x2: shift + ku * scale, y2: kv * scale, class: "match" }));
  const picture = svg(
    "svg",
    { viewBox: `0 0 ${width} ${left.height}`, class: "matches", role: "img", "aria-label": `${pairs.length} matches between the photo, left, and keyframe ${keyframe}, right` },
    svg("image", { href: left.url, width: left.width, height: left.height }),
    svg("image", { href: right.url, x: shift, width: right.width * scale, height: left.height }),
    ...lines,
  );
  return el("figure", { class: "card" }, picture, el("figcaption", {}, `${pairs.length} matches with keyframe ${keyframe}.`));
}

async function size(url) {
  const image = new Image();
  image.src = url;
  await image.decode();
  return { url, width: image.naturalWidth, height: image.naturalHeight };
}
