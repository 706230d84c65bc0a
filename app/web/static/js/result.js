// The answer to one photo, as a card.

import { byId, copyButton, el } from "./dom.js";
import { degrees, metres, milliseconds, reasonWords, stageWords } from "./words.js";

const CAMERA_SOURCES = {
  request: "as given",
  search: "focal length found by search",
  exif: "from the photo",
  unknown: "unknown",
};

/** Show an answer of POST /locate with its photo, `{answer, number, name, url}`, and the name of its floor. */
export function showResult({ answer, number, name, url }, floorName) {
  const card = el("section", { class: "card result", "aria-label": "Result" });
  const photo = el("figure", {}, el("img", { src: url, alt: "" }), el("figcaption", {}, `Photo ${number}: ${name}`));
  card.append(photo, ...(answer.located ? located(answer, floorName) : notLocated(answer)));
  card.append(timings(answer.timings_ms), raw(answer));
  byId("result").replaceChildren(card);
}

/** Return the horizontal angle of view of an answer's camera in degrees, or null. */
export function fieldOfView(camera) {
  const focal = camera?.params?.[0];
  return focal > 0 ? (360 / Math.PI) * Math.atan(camera.width / (2 * focal)) : null;
}

function located(answer, floorName) {
  const { plan, pose, accuracy, confidence } = answer;
  const where = [floorName ?? "In the map, on no floor", plan?.area_name ?? plan?.area].filter(Boolean).join(", ");
  const rows = [];
  if (plan) rows.push(["On the plan", `x ${plan.x.toFixed(2)} m, y ${plan.y.toFixed(2)} m`]);
  if (plan) rows.push(["Heading", `${degrees(plan.heading_deg)} from plan x, counter-clockwise`]);
  if (plan?.nearest_landmark) rows.push(["Nearest landmark", String(plan.nearest_landmark_name ?? plan.nearest_landmark)]);
  if (pose) rows.push(["In the map", xyz(pose.position)], ["Quaternion", xyzw(pose.quaternion)]);
  rows.push(["Evidence", `${answer.inliers} of ${answer.matches} matches agree, ${answer.keyframes.length} keyframes`]);
  if (answer.camera) rows.push(["Camera", camera(answer.camera)]);
  if (answer.map_version !== null) rows.push(["Map", `version ${answer.map_version}`]);
  return [
    el("div", { class: "verdict verdict-good" }, tick(), el("div", {}, el("h2", {}, "Located"), el("p", {}, where))),
    el(
      "div",
      { class: "figures" },
      figure("Position", accuracy ? `± ${metres(accuracy.position_m)}` : "unknown"),
      figure("Orientation", accuracy ? `± ${degrees(accuracy.orientation_deg, 2)}` : "unknown"),
      figure("Confidence", `${Math.floor(confidence * 100)} %`, confidenceBar(confidence)),
    ),
    table(rows),
  ];
}

function notLocated(answer) {
  const [matter, help] = reasonWords(answer.reason);
  const words = [el("h2", {}, "Not located"), el("p", {}, matter)];
  const rows = [];
  if (answer.matches) rows.push(["Evidence", `${answer.inliers} of ${answer.matches} matches agree: not enough`]);
  if (answer.map_version !== null) rows.push(["Map", `version ${answer.map_version}`]);
  rows.push(["Reason code", answer.reason]);
  return [
    el("div", { class: "verdict verdict-none" }, question(), el("div", {}, ...words)),
    el("p", { class: "advice" }, help, answer.reason === "no_map" ? el("a", { href: "#maps" }, " Open Maps") : null),
    table(rows),
  ];
}

function xyz({ x, y, z }) {
  return `${x.toFixed(3)}, ${y.toFixed(3)}, ${z.toFixed(3)} m`;
}

function xyzw({ x, y, z, w }) {
  return [x, y, z, w].map((value) => value.toFixed(4)).join(", ");
}

function camera({ params, width, height, source }) {
  return `f = ${params[0].toFixed(1)} px at ${width} × ${height}, ${CAMERA_SOURCES[source] ?? source}`;
}

function figure(name, value, extra = null) {
  return el("div", { class: "figure" }, el("span", {}, name), el("strong", {}, value), extra);
}

function confidenceBar(confidence) {
  const title = "Probability that the error is below 0.5 m and 5 degrees";
  return el("meter", { min: 0, max: 1, low: 0.5, high: 0.8, optimum: 1, value: confidence, title, "aria-label": title });
}

function table(rows) {
  return el("dl", { class: "rows" }, ...rows.map(([name, value]) => el("div", {}, el("dt", {}, name), el("dd", {}, value))));
}

function timings(times) {
  const { total = 0, ...stages } = times;
  const { decode, ...later } = stages;
  const shown = Object.entries({ decode, ...later }).filter(([, value]) => value > 0);
  const bar = el("div", { class: "time-bar", "aria-hidden": "true" });
  const legend = el("ul", { class: "time-legend" });
  shown.forEach(([stage, value], index) => {
    const part = el("i", { class: `tint-${index % 6}` });
    part.style.flexGrow = String(value);
    bar.append(part);
    const swatch = el("i", { class: `tint-${index % 6}`, "aria-hidden": "true" });
    legend.append(el("li", {}, swatch, `${stageWords(stage)} `, el("span", {}, milliseconds(value))));
  });
  return el("div", { class: "timings" }, el("h3", {}, `Answered in ${milliseconds(total)}`), bar, legend);
}

function raw(answer) {
  const text = JSON.stringify(answer, null, 2);
  const button = el("button", { type: "button", class: "small" }, "Copy");
  copyButton(button, () => text);
  const code = el("div", { class: "code" }, el("pre", { tabindex: "0" }, text), button);
  return el("details", {}, el("summary", {}, "The answer as JSON"), code);
}

function tick() {
  return el("span", { class: "badge-round", "aria-hidden": "true" }, "✓");
}

function question() {
  return el("span", { class: "badge-round", "aria-hidden": "true" }, "?");
}
