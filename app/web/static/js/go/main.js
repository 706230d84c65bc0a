// The phone page: from the camera's frames to a dot on the plan and words that lead.

import { path, requestJson, storedKey } from "../api.js";
import { byId, guarded } from "../dom.js";
import { setUpAwake } from "./awake.js";
import { setUpKey } from "./key.js";
import { showLanguages } from "./languages.js";
import { Camera, SimulatedCamera } from "./camera.js";
import { Guide } from "./guide.js";
import { Plan } from "./plan.js";
import { Search } from "./search.js";
import { SessionStream } from "./stream.js";
import { Voice } from "./voice.js";
import { knows, language, loadWords, say } from "./words.js";

const venue = decodeURIComponent(location.pathname.replace(/\/$/, "").split("/").at(-1));
// The token of a QR code stands in the fragment, which no server's log ever has.
const fragment = new URLSearchParams(location.hash.slice(1));
const token = fragment.get("token");
let stream = null;
let guide = null;
let search = null;
const stayAwake = setUpAwake(() => !byId("tools").hidden);

async function start() {
  if (token) {
    storedKey.set(token);
    history.replaceState(null, "", location.pathname + location.search);
  }
  showLanguages(await loadWords(), async (tag) => {
    translate();
    guide.refresh();
    await stream?.change({ language: tag }).catch((error) => guide.problem(error.message));
  });
  setUpKey();
  const plan = new Plan(venue);
  const voice = new Voice(byId("voice"));
  guide = new Guide(venue, plan, voice);
  search = new Search(venue, (place) => lead(place));
  byId("search").addEventListener("click", () => search.open(() => plan.load()));
  byId("cancel").addEventListener("click", () => lead(null));
  byId("start-camera").addEventListener("click", (event) => begin(event.target, new Camera(byId("camera"))));
  byId("start-simulated").addEventListener("click", (event) => begin(event.target, new SimulatedCamera(venue)));
  translate();
  try {
    const found = await requestJson(path("venues", venue));
    document.title = say("title", { venue: found.name });
    byId("title").textContent = found.name;
    await plan.load();
    guide.hasMap = found.map_version !== null;
    // The pictures of the map are for those who run the venue, or anybody on an open server: no visitor sees them.
    byId("start-simulated").hidden = !guide.hasMap || storedKey.get() !== null;
    // A visitor's token may not record, so only those who come without one are offered it.
    byId("record-link").hidden = storedKey.get() !== null;
    byId("record-link").href = `../record/${encodeURIComponent(venue)}`;
    if (fragment.has("simulated") && guide.hasMap) byId("start-simulated").click();
  } catch (error) {
    byId("start-camera").disabled = true;
    guide.problem(error.status === 404 ? say("error.venue") : error.message);
  }
}

async function begin(button, camera) {
  const begun = streamOf(camera);
  // One way to begin at a time.
  const others = ["start-camera", "start-simulated"].map(byId).filter((other) => other !== button && !other.disabled);
  for (const other of others) other.disabled = true;
  const opened = await guarded(button, byId("start-error"), async () => {
    guide.show(say("starting"));
    // The session begins while the camera opens.
    await Promise.all([camera.open(), begun.prepare()]);
    return true;
  });
  for (const other of others) other.disabled = false;
  if (!opened) {
    begun.stop();
    return guide.show("");
  }
  byId("start").hidden = true;
  byId("tools").hidden = false;
  guide.begin(camera);
  await stayAwake();
  stream = begun;
  return stream.run();
}

function streamOf(camera) {
  const wishes = { language: language(), destination: guide.destination?.id ?? null, share: byId("share").checked };
  return new SessionStream(venue, camera, wishes, {
    answer: (body) => {
      guide.answer(body);
      camera.learner?.answer(body);
    },
    state: (state) => {
      guide.connection(state);
      if (state === "replaced") end(camera);
    },
    error: (error) => {
      end(camera);
      guide.problem(error.message);
    },
  });
}

function end(camera) {
  camera.close();
  stream = null;
  byId("start").hidden = false;
  byId("tools").hidden = true;
  stayAwake();
}

async function lead(place) {
  guide.lead(place);
  byId("cancel").hidden = place === null;
  await stream?.change({ destination: place?.id ?? null }).catch((error) => guide.problem(error.message));
}

function translate() {
  const texts = {
    "start-words": "start.words", "start-camera": "start", "start-simulated": "start.simulated",
    "start-privacy": "start.privacy", "share-words": "start.share", "record-link": "record", search: "search", cancel: "cancel", "search-title": "search.title",
    "query-label": "search.query", "search-close": "search.close", "language-words": "language",
    "key-title": "key.title", "key-label": "key", "key-use": "key.use", "key-cancel": "key.cancel",
  };
  for (const [id, key] of Object.entries(texts)) byId(id).textContent = say(key);
  for (const id of ["voice", "follow", "floors"]) {
    if (!knows(id)) continue;
    byId(id).setAttribute("aria-label", say(id));
    byId(id).title = say(id);
  }
}

start();
