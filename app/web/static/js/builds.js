// One build on the screen: its upload, its stages as they happen, its end.

import { buildEvents, path, requestJson } from "./api.js";
import { el, guarded, notice } from "./dom.js";
import { buildStageWords, bytes, count, moment, seconds } from "./words.js";

const RETRY_MS = 2000;

export class Progress {
  /** Shows progress in `place`; `onEnd` runs when a build has ended. */
  constructor(place, onEnd) {
    this.place = place;
    this.onEnd = onEnd;
    this.following = null;
    this.venue = null;
    this.uploading = false;
  }

  /** Run an upload, given as a function of a progress listener and an abort signal. */
  async upload(send) {
    this.stop();
    this.venue = null;
    this.uploading = true;
    const abort = new AbortController();
    const cancel = el("button", { type: "button", class: "small", on: { click: () => abort.abort() } }, "Cancel");
    const card = new ProgressCard(this.place, cancel);
    card.show("upload", 0, 0, "");
    try {
      const report = (done, total, words) => card.show("upload", done, total, words ?? `${bytes(done)} of ${bytes(total)}`);
      return await send(report, abort.signal);
    } catch (error) {
      this.place.replaceChildren();
      throw error;
    } finally {
      this.uploading = false;
    }
  }

  /** Follow a build until it has ended; null clears the place when it shows another venue's build. */
  follow(build, venue) {
    if (this.uploading || (build && this.following?.build === build.build)) return;
    // A list that was asked for before the build was submitted knows nothing of it: its own events tell its end.
    if (!build && this.venue === venue) return;
    this.stop();
    this.place.replaceChildren();
    this.venue = venue;
    if (!build) return;
    this.following = { build: build.build, abort: new AbortController() };
    this.watch(build, this.following.abort.signal);
  }

  stop() {
    this.following?.abort.abort();
    this.following = null;
  }

  async watch(build, signal) {
    const error = el("div", { role: "alert" });
    const cancel = el("button", { type: "button", class: "small danger" }, "Cancel build");
    const card = new ProgressCard(this.place, cancel, error);
    const where = path("database", "builds", build.build);
    cancel.addEventListener("click", () =>
      guarded(cancel, error, async () => {
        await requestJson(where, { method: "DELETE" });
        cancel.textContent = "Cancelling";
      }),
    );
    card.build(build);
    let last = build;
    while (!hasEnded(last)) {
      try {
        for await (const state of buildEvents(build.build, signal)) {
          last = state;
          if (hasEnded(state)) break;
          card.build(state);
        }
      } catch (problem) {
        if (signal.aborted) return;
        if (problem.status >= 400 && problem.status < 500) {
          error.replaceChildren(notice("error", problem.message));
          return;
        }
        // The stream broke off: the build goes on without us, so look again.
      }
      if (signal.aborted) return;
      if (!hasEnded(last)) await new Promise((resume) => setTimeout(resume, RETRY_MS));
      if (signal.aborted) return;
    }
    this.following = null;
    this.place.replaceChildren(ending(last));
    this.onEnd();
  }
}

class ProgressCard {
  constructor(place, ...controls) {
    this.started = Date.now();
    this.title = el("h2", {}, "");
    this.bar = el("progress", { max: 1, "aria-label": "Progress" });
    this.note = el("p", { class: "help" });
    place.replaceChildren(el("section", { class: "card progress" }, this.title, this.bar, this.note, ...controls));
  }

  build({ state, stage, done, total, started_at: startedAt }) {
    if (state === "queued") return this.show(null, 0, 0, "It starts when the builds before it are done.");
    if (startedAt) this.started = Date.parse(startedAt);
    const elapsed = seconds(Math.max(0, (Date.now() - this.started) / 1000));
    const steps = total > 1 ? `${count(done)} of ${count(total)}, ` : "";
    return this.show(stage ?? "read", done, total > 1 ? total : 0, `${steps}${elapsed} so far`);
  }

  show(stage, done, total, note) {
    this.title.textContent = stage === null ? "Waiting" : buildStageWords(stage);
    if (total > 0) this.bar.value = done / total;
    else this.bar.removeAttribute("value");
    this.note.textContent = note;
  }
}

/** Return a line about a build that has ended without a map. */
export function endedBuild(build) {
  const head = el("strong", {}, build.state === "failed" ? "Failed" : "Cancelled");
  const when = el("time", { datetime: build.created_at }, moment(build.created_at));
  const why = build.error ? el("p", {}, build.error) : null;
  return el("section", { class: `card ended ended-${build.state}` }, el("div", { class: "map-head" }, head, when), why);
}

function ending(build) {
  if (build.state === "succeeded") return notice("good", `Version ${build.map_version} is built and serves now.`);
  if (build.state === "cancelled") return notice("info", "The build was cancelled. The map before it still serves.");
  return notice("error", el("strong", {}, "The build failed. "), build.error ?? "The server gave no reason.");
}

function hasEnded({ state }) {
  return state === "succeeded" || state === "failed" || state === "cancelled";
}
