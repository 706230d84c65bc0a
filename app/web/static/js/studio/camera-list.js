// The cameras of a floor: how old their pictures are, what can be recognised in them, and whether the map has found them.

import { byId, el } from "../dom.js";
import { metres, seconds } from "../words.js";

export class CameraList {
  /** `actions`: label -> what its button does with a camera; the label is the button's name before the camera's id. */
  constructor(actions) {
    Object.assign(this, { actions, entries: new Map() });
  }

  /** Show cameras. Buttons stay where the cameras are the same, so that the keyboard keeps its place. */
  show(anchors) {
    if (!anchors.length) byId("cameras").replaceChildren(el("li", {}, "None yet."));
    const isSame = anchors.length === this.entries.size && anchors.every((anchor) => this.entries.has(anchor.id));
    if (!isSame) {
      this.entries = new Map(anchors.map((anchor) => [anchor.id, this.entry(anchor.id)]));
      if (anchors.length) byId("cameras").replaceChildren(...[...this.entries.values()].map(({ node }) => node));
    }
    for (const anchor of anchors) {
      const entry = this.entries.get(anchor.id);
      entry.anchor = anchor;
      entry.state.replaceChildren(...health(anchor).map(([kind, words]) => el("span", { class: kind }, words)));
    }
  }

  entry(id) {
    const state = el("p", { class: "help health" });
    const entry = { state, anchor: null };
    const buttons = Object.entries(this.actions).map(([label, act]) => {
      const kind = label === "Delete" ? "small danger" : "small";
      const button = el("button", { type: "button", class: kind, "aria-label": `${label}: ${id}` }, label);
      button.addEventListener("click", () => act(entry.anchor, button));
      return button;
    });
    entry.node = el("li", {}, el("strong", {}, id), state, el("div", { class: "actions" }, ...buttons));
    return entry;
  }
}

/** Return [kind, sentence] for each thing to know of a camera. */
function health({ frame, calibration, uses, pois }) {
  const found = [];
  if (!frame) {
    found.push(["bad", "No picture yet: let roomfix push-frames run beside it."]);
  } else {
    const age = seconds(frame.age_s);
    found.push(frame.fresh ? ["good", `Last picture ${age} ago.`] : ["bad", `Silent for ${age}: its picture is too old to be used.`]);
    const unseen = pois.filter((poi) => !frame.pois_visible.includes(poi.id)).map((poi) => poi.id);
    if (unseen.length) found.push(["bad", `Can't recognise ${unseen.join(", ")} in it.`]);
  }
  found.push(calibration ? ["good", `Found in the map within ${metres(calibration.accuracy.position_m)}.`] : ["", "Not found in the map yet."]);
  if (uses) found.push(["", uses === 1 ? "Has located one phone." : `Has located phones ${uses} times.`]);
  return found;
}
