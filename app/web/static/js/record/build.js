// What becomes of a recording: watched until its map serves, or until it is said why there is none.

import { path, requestJson } from "../api.js";
import { byId, el } from "../dom.js";
import { rememberCamera } from "../go/known-camera.js";
import { knows, say } from "../go/words.js";
import { isPassing } from "./sender.js";

const EVERY_MS = 1000;
const LOOKING = ["start", "unpack", "read", "measure_frames", "choose_frames", "find_features"];
const CONNECTING = ["match_frames", "measure_motions", "reconstruct", "join_parts", "find_loops", "adjust_structure", "hold_to_depth", "find_up", "find_marker", "find_scale"];

/** Show a build until it has ended; returns it. `show(words, more)` says what happens, `isOn()` whether to go on. */
export async function watchBuild(recording, show, isOn) {
  while (isOn()) {
    try {
      const { build } = await requestJson(path("recordings", recording));
      if (build === null) return null;
      if (build.state !== "queued" && build.state !== "running") return build;
      showStage(build, show);
    } catch (error) {
      if (!isPassing(error)) throw error;
      show(say("connection.lost"), say("record.leave"));
    }
    await new Promise((resolve) => setTimeout(resolve, EVERY_MS));
  }
  return null;
}

/** Show how a build has ended. */
export function showEnd(build, size, show) {
  const done = build.state === "succeeded";
  byId("build-progress").hidden = true;
  byId("go-link").hidden = !done;
  byId("again").hidden = done;
  byId("record-new").hidden = false;
  byId("warnings").replaceChildren(...[...leftOutWords(build.left_out), ...build.warnings].map((words) => el("li", {}, words)));
  if (!done) return show(say("record.failed"), build.error ?? "");
  const focalPx = build.camera?.params[0];
  if (size && focalPx) rememberCamera({ ...size, focalPx });
  return show(say("record.done"), say("record.done.more", { connected: build.connected ?? 0, chosen: build.chosen ?? 0 }));
}

/** Return a sentence for each reason for which frames are not in the map. */
function leftOutWords(counts) {
  const reasons = Object.entries(counts).filter(([reason, frames]) => frames > 0 && knows(`record.left.${reason}`));
  return reasons.map(([reason, frames]) => say(`record.left.${reason}`, { frames }));
}

function showStage({ state, stage, done, total }, show) {
  const bar = byId("build-progress");
  bar.hidden = false;
  if (total > 0) bar.value = done / total;
  else bar.removeAttribute("value");
  const words = state === "queued" ? "queued" : LOOKING.includes(stage) ? "looking" : CONNECTING.includes(stage) ? "connecting" : "mapping";
  show(say(`record.${words}`), say("record.leave"));
}
