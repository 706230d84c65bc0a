// What the page says and shows for each answer: the place, the next instruction, or that nothing is known.

import { path, requestJson } from "../api.js";
import { byId } from "../dom.js";
import { turns } from "../turns.js";
import { knows, language, metres, say } from "./words.js";

// A frame now and then is not located; the person is told when none was for this time.
const PATIENCE_MS = 1500;
// A step nearer than this is said again, since it is to be done now.
const NOW_M = 2;
const LEAST_ACCURACY_M = 0.01;

/** Return an accuracy in metres for people: never 0, which nothing is. */
export function accuracyWords(accuracyM) {
  return Math.max(accuracyM, LEAST_ACCURACY_M).toLocaleString(language(), { maximumFractionDigits: 2 });
}

export class Guide {
  constructor(venue, plan, voice) {
    Object.assign(this, { venue, plan, voice });
    this.destination = null;
    this.locatedAt = 0;
    this.last = null;
    this.route = null;
    this.hasMap = true;
    this.routes = turns();
    // Which floor is shown is part of the words.
    plan.onShown = () => {
      if (byId("go").dataset.state === "located" && this.last?.located && this.last.plan) this.here(this.last);
    };
  }

  begin(camera) {
    this.locatedAt = 0;
    this.simulated = Boolean(camera.isSimulated);
    this.show(say("searching"), say("searching.more"));
  }

  /** Show the words at the top, the arrow where a direction is known, and what is less important below. */
  show(words, more = "", bearingDeg = null) {
    const text = byId("say-words");
    if (text.textContent !== words) text.textContent = words;
    byId("say-more").textContent = more;
    byId("arrow").toggleAttribute("hidden", bearingDeg === null);
    if (bearingDeg !== null) byId("arrow").style.rotate = `${-bearingDeg}deg`;
  }

  problem(sentence) {
    this.state("problem");
    this.show(say("error"), sentence);
  }

  connection(state) {
    if (state === "lost") {
      this.state("offline");
      this.plan.stale(true);
      this.show(say("connection.lost"), say("connection.more"));
    } else if (state === "replaced") {
      this.state("offline");
      this.show(say("connection.replaced"), say("connection.replaced.more"));
    } else if (byId("go").dataset.state === "offline") {
      this.state("searching");
      this.show(say("searching"), say("searching.more"));
    }
  }

  /** Lead to a place, `{id, name}`; null stops. */
  lead(place) {
    this.destination = place;
    this.route = null;
    this.plan.lead([]);
    this.voice.said = null;
    this.refresh();
  }

  /** Say anew what is known without guidance: the next answer brings that in the language, and to the place, asked for. */
  refresh() {
    if (this.last?.located && this.last.plan) this.here(this.last);
    else if (this.last) this.show(say("searching"), say("searching.more"));
  }

  /** Take one answer of the session. */
  answer(body) {
    this.last = body;
    const now = performance.now();
    const place = body.located ? body.plan : null;
    if (place) {
      this.locatedAt = now;
      this.plan.move({
        floor: body.floor,
        x: place.x,
        y: place.y,
        headingDeg: place.heading_deg,
        accuracyM: body.accuracy?.position_m ?? 0,
        number: body.received,
      });
    }
    if (place && this.destination && body.guidance) this.guidance(body);
    else if (place) this.here(body);
    else if (body.located) this.unplaced("no_plan");
    else if (now - this.locatedAt > PATIENCE_MS) this.lost(body);
  }

  here({ plan, accuracy }) {
    this.state("located");
    const name = plan.area_name ?? null;
    // What is shown is not where they are.
    const elsewhere = this.plan.otherFloor;
    const here = name ? say("here.area", { area: name }) : say("here");
    const words = elsewhere === null ? here : say("here.floor", { floor: elsewhere });
    const parts = [];
    if (plan.nearest_landmark_name) parts.push(say("here.near", { landmark: plan.nearest_landmark_name }));
    if (accuracy) parts.push(say("here.more", { metres: accuracyWords(accuracy.position_m) }));
    if (this.simulated) parts.push(say("simulated"));
    this.show(words, parts.join(" · "));
  }

  lost({ reason, guidance }) {
    this.state("lost");
    this.plan.stale(true);
    const key = this.hasMap ? `lost.${reason}` : "lost.no_map";
    const advice = knows(key) ? say(key) : say("searching.more");
    const first = !this.plan.place;
    const words = guidance?.problem === "lost" && guidance.instruction ? guidance.instruction : say(first ? "searching" : "lost");
    this.show(words, advice);
    this.voice.say(`lost ${first}`, `${words} ${advice}`);
  }

  unplaced(key) {
    this.state("lost");
    this.show(say("here"), say(`lost.${key}`));
  }

  guidance({ guidance, floor, plan }) {
    const name = this.destination.name;
    if (guidance.problem && guidance.problem !== "lost") {
      this.state("lost");
      return this.show(say("no_way", { destination: name }), guidance.detail ?? "");
    }
    if (guidance.planned || this.route === null) this.draw(floor, plan);
    if (guidance.arrived) {
      this.state("arrived");
      this.show(say("arrived"), say("arrived.more", { destination: name }));
      return this.voice.say("arrived", `${say("arrived")}: ${name}`);
    }
    this.state(guidance.off_route ? "off-route" : "leading");
    const remaining = guidance.remaining_m === null ? name : say("remaining", { metres: metres(guidance.remaining_m), destination: name });
    this.show(guidance.instruction, remaining, guidance.bearing_deg ?? null);
    const near = guidance.distance_m !== null && guidance.distance_m < NOW_M;
    const topic = [guidance.turn, guidance.landmark, guidance.off_route, near].join(" ");
    return this.voice.say(topic, guidance.instruction);
  }

  /** Draw the way from here; the session leads along the same one. */
  async draw(floor, { x, y }) {
    const wanted = this.destination;
    const isLatest = this.routes();
    const isWanted = () => isLatest() && this.destination === wanted;
    this.route = [];
    const query = new URLSearchParams({ from: `${floor}:${x},${y}`, to: wanted.id, language: language() });
    try {
      const route = await requestJson(`${path("venues", this.venue, "route")}?${query}`);
      if (!isWanted()) return;
      this.route = route.path;
      this.plan.lead(route.path);
    } catch {
      // The session says by itself when there is no way.
      if (isWanted()) this.plan.lead([]);
    }
  }

  state(name) {
    byId("go").dataset.state = name;
  }
}
