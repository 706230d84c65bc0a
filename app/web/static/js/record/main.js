// The page that records a scan: film, send meanwhile, say how large the place is, and watch its map being built.

import { path, request, requestJson, storedKey } from "../api.js";
import { byId, el, guarded, showError } from "../dom.js";
import { setUpAwake } from "../go/awake.js";
import { Camera } from "../go/camera.js";
import { setUpKey } from "../go/key.js";
import { showLanguages } from "../go/languages.js";
import { loadWords, say } from "../go/words.js";
import { showEnd, watchBuild } from "./build.js";
import { Film } from "./film.js";
import { openPending } from "./pending.js";
import { Sender, isPassing } from "./sender.js";
import { Size } from "./size.js";

const venue = decodeURIComponent(location.pathname.replace(/\/$/, "").split("/").at(-1));
const REMEMBERED = `roomfix.recording.${venue}`;
// The server takes 1500; a reconstruction uses fewer.
const MAX_FRAMES = 1200;
const MAX_PENDING = 400;
const MIN_FRAMES = 12;
const STEPS = ["start", "film", "size", "build"];

const stayAwake = setUpAwake(() => !byId("step-film").hidden);
let pending = null;
let size = null;
// {recording, frames, startedAt, width, height}: what a page that is opened again has to know.
let work = null;
let sender = null;
let film = null;
let camera = null;
let isOffline = false;
let isFilming = false;
let isFull = false;

async function start() {
  const token = new URLSearchParams(location.hash.slice(1)).get("token");
  if (token) {
    storedKey.set(token);
    history.replaceState(null, "", location.pathname + location.search);
  }
  showLanguages(await loadWords("record"), translate);
  setUpKey();
  size = new Size();
  pending = await openPending();
  byId("start-film").addEventListener("click", (event) => guarded(event.target, byId("start-error"), beginFilm));
  byId("stop-film").addEventListener("click", stopFilm);
  byId("film-on").addEventListener("click", (event) => guarded(event.target, byId("size-error"), beginFilm));
  byId("earlier-finish").addEventListener("click", openSize);
  byId("earlier-discard").addEventListener("click", (event) => guarded(event.target, byId("start-error"), discard));
  byId("again").addEventListener("click", openSize);
  byId("record-new").addEventListener("click", (event) => guarded(event.target, byId("start-error"), discard));
  byId("step-size").addEventListener("submit", (event) => {
    event.preventDefault();
    guarded(byId("build"), byId("size-error"), build);
  });
  translate();
  try {
    const found = await requestJson(path("venues", venue));
    document.title = say("record.title", { venue: found.name });
    byId("title").textContent = document.title;
    byId("extend-row").hidden = found.map_version === null;
    byId("go-link").href = `../go/${encodeURIComponent(venue)}`;
    await goOn();
    // Not before: what an earlier page has left would be lost.
    byId("start-film").disabled = false;
  } catch (error) {
    problem(error.status === 404 ? say("error.venue") : error.message);
  }
}

/** Take up what an earlier page has left: its frames are sent, or its build is watched. */
async function goOn() {
  work = JSON.parse(localStorage.getItem(REMEMBERED) ?? "null");
  if (work === null) return show(document.title);
  const state = await stateOf(work.recording);
  if (state === null) {
    await forget();
    return show(document.title, say("record.gone"));
  }
  if (state.build) return watch();
  startSender();
  byId("earlier").hidden = false;
  byId("start-film").textContent = say("record.on");
  return show(say("record.earlier", { kept: work.frames }));
}

async function stateOf(recording) {
  try {
    return await requestJson(path("recordings", recording));
  } catch (error) {
    if (error.status === 404) return null;
    throw error;
  }
}

async function beginFilm() {
  camera = new Camera(byId("camera"));
  await camera.open();
  try {
    if (work === null) {
      const begun = await requestJson("recordings", { method: "POST", json: { venue } });
      work = { recording: begun.recording, frames: 0, startedAt: Date.now() };
      remember();
    }
  } catch (error) {
    camera.close();
    throw error.status === 403 ? new Error(say("record.forbidden")) : error;
  }
  const { videoWidth: width, videoHeight: height } = byId("camera");
  Object.assign(work, { width, height });
  startSender();
  isFilming = true;
  film = new Film(byId("camera"), work.startedAt, { keep, hint, mayKeep });
  step("film");
  byId("counts").hidden = false;
  film.run();
  showCounts();
}

/** Return why no frame may be kept now, null where one may. */
async function mayKeep() {
  if (isFull || work.frames >= MAX_FRAMES) return "full";
  return (await pending.count(work.recording)) >= MAX_PENDING ? "waiting" : null;
}

async function keep(frame) {
  const number = work.frames;
  try {
    await pending.put({ recording: work.recording, number, ...frame });
  } catch {
    // The phone's disk has no room: what is kept so far becomes the map.
    isFull = true;
    return;
  }
  work.frames += 1;
  remember();
  size.add(number, frame.picture);
  sender.wake();
  await showCounts();
}

function hint(name) {
  if (isFilming) show(say("record.filming"), isOffline && name === "steady" ? say("record.offline") : say(`record.${name}`));
}

async function showCounts() {
  const { recording } = work;
  const left = await pending.count(recording);
  // The recording was deleted meanwhile.
  if (work?.recording !== recording) return;
  const seconds = Math.round((Date.now() - work.startedAt) / 1000);
  byId("counts").textContent = say("record.counts", { kept: work.frames, sent: work.frames - left, seconds });
}

function startSender() {
  sender ??= new Sender(work.recording, pending, {
    sent: () => work && showCounts(),
    offline: (now) => {
      isOffline = now;
      if (now && isFilming) show(say("record.filming"), say("record.offline"));
    },
    refused: (error) => {
      stopCamera();
      sender = null;
      step("start");
      problem(error.status === 404 ? say("record.gone") : error.message);
      if (error.status === 404) forget();
    },
  });
  sender.run();
}

function stopCamera() {
  isFilming = false;
  film?.stop();
  camera?.close();
  byId("counts").hidden = true;
}

function stopFilm() {
  stopCamera();
  if (work.frames < MIN_FRAMES) {
    step("start");
    byId("start-film").textContent = say("record.on");
    return show(say("record.few", { kept: work.frames }));
  }
  return openSize();
}

function openSize() {
  step("size");
  show(say("record.size"), say("record.size.more"));
  size.open();
}

async function build() {
  const scale = size.value();
  await allSent();
  const mode = byId("extend").checked && !byId("extend-row").hidden ? "extend" : "replace";
  const body = { frames: work.frames, mode, ...(scale ? { scale } : {}) };
  await patiently(() => requestJson(path("recordings", work.recording, "finish"), { method: "POST", json: body }));
  return watch();
}

/** Wait until all frames are on the server. */
async function allSent() {
  step("build");
  for (;;) {
    const left = await pending.count(work.recording);
    if (!left) return;
    if (!sender) {
      openSize();
      throw new Error(say("error"));
    }
    show(say("record.sending"), isOffline ? say("record.offline") : say("record.sending.more", { left }));
    byId("build-progress").value = (work.frames - left) / work.frames;
    await new Promise((resolve) => setTimeout(resolve, 200));
  }
}

/** Call until the server answers. */
async function patiently(call) {
  for (;;) {
    try {
      return await call();
    } catch (error) {
      if (!isPassing(error)) {
        openSize();
        throw error;
      }
      show(say("connection.lost"), say("connection.more"));
      await new Promise((resolve) => setTimeout(resolve, 1000));
    }
  }
}

async function watch() {
  const { recording } = work;
  step("build");
  for (const id of ["go-link", "again", "record-new"]) byId(id).hidden = true;
  byId("warnings").replaceChildren();
  show(say("record.queued"), say("record.leave"));
  const ended = await watchBuild(recording, show, () => work?.recording === recording);
  if (!ended) return;
  showEnd(ended, work.width ? work : null, show);
  // Its map serves: there is nothing left to go on with.
  if (ended.state === "succeeded") localStorage.removeItem(REMEMBERED);
}

async function discard() {
  const { recording } = work;
  sender?.stop();
  sender = null;
  await forget();
  await request(path("recordings", recording), { method: "DELETE" }).catch((error) => {
    // What is left of it the server deletes by itself after some days.
    if (error.status !== 404 && !isPassing(error)) throw error;
  });
  size.shots = [];
  byId("earlier").hidden = true;
  step("start");
  translate();
  show(document.title);
}

async function forget() {
  if (work) await pending.clear(work.recording);
  work = null;
  localStorage.removeItem(REMEMBERED);
}

const remember = () => localStorage.setItem(REMEMBERED, JSON.stringify(work));

function step(name) {
  for (const each of STEPS) byId(`step-${each}`).hidden = each !== name;
  byId("record").dataset.step = name;
  delete byId("record").dataset.state;
  showError(byId("start-error"), null);
  stayAwake();
}

function show(words, more = "") {
  if (byId("say-words").textContent !== words) byId("say-words").textContent = words;
  if (byId("say-more").textContent !== more) byId("say-more").textContent = more;
}

function problem(sentence) {
  byId("record").dataset.state = "problem";
  show(say("error"), sentence);
}

function translate() {
  const texts = {
    "start-film": work === null ? "record.start" : "record.on", "start-privacy": "record.privacy", "stop-film": "record.stop",
    "earlier-finish": "record.finish", "earlier-discard": "record.discard", "size-title": "record.size",
    "size-marker": "record.size.marker", "size-distance": "record.size.distance", "size-height": "record.size.height",
    "size-none": "record.size.none", "shot-before": "record.shot.before", "shot-after": "record.shot.after",
    "points-again": "record.points.again", "extend-words": "record.extend", build: "record.build", "film-on": "record.film.on",
    "go-link": "record.go", again: "record.again", "record-new": "record.new", "language-words": "language",
    "key-title": "key.title", "key-label": "key", "key-use": "key.use", "key-cancel": "key.cancel",
  };
  for (const [id, key] of Object.entries(texts)) byId(id).textContent = say(key);
  byId("how").replaceChildren(...say("record.how").split("|").map((words) => el("li", {}, words)));
}

start();
