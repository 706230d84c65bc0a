// A cross that arrow keys move over a drawing, for those who use no mouse. Where it is, is told to screen readers.

import { svg } from "../dom.js";

const STEP_PX = 16;
const COARSE_PX = 80;
const FINE_PX = 1;
const ARM_PX = 14;
// Screen readers are told where the cross is once it rests: while a key is held it passes many places.
const REST_MS = 250;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export class Cross {
  /**
   * `box` has the keyboard while the cross is shown, and `words` says where it is. `drawing` has what differs:
   * `unitsPerPx()` of the screen, `middle()` where the cross begins, `limit(point)` that keeps it on the drawing, and
   * `describe(point)`. Points are in the units of the SVG.
   */
  constructor(box, words, drawing) {
    Object.assign(this, { box, words, drawing, at: null, resting: null });
    this.node = svg("path", { class: "cross", visibility: "hidden" });
    box.addEventListener("focus", () => box.matches(":focus-visible") && this.begin());
    box.addEventListener("blur", () => this.hide());
  }

  /** Take the cross away: what it was on is not shown any more. */
  forget() {
    this.at = null;
    this.hide();
  }

  hide() {
    this.node.setAttribute("visibility", "hidden");
    this.say("");
  }

  /** Show the cross where it was, or in the middle; returns where it is, null where there is no drawing. */
  begin() {
    this.at ??= this.drawing.middle();
    if (this.at) this.draw();
    return this.at;
  }

  /** Move by an arrow key; returns whether it was one. */
  move(event) {
    const direction = ARROWS[event.key];
    if (!direction || !this.begin()) return false;
    const fine = event.ctrlKey || event.altKey || event.metaKey;
    const step = (event.shiftKey ? COARSE_PX : fine ? FINE_PX : STEP_PX) * this.drawing.unitsPerPx();
    this.at = this.drawing.limit(this.at.map((value, i) => value + step * direction[i]));
    this.draw();
    return true;
  }

  draw() {
    const [u, v] = this.at;
    const arm = ARM_PX * this.drawing.unitsPerPx();
    this.node.setAttribute("d", `M ${u - arm} ${v} H ${u + arm} M ${u} ${v - arm} V ${v + arm}`);
    this.node.setAttribute("visibility", "visible");
    this.say(null);
  }

  /** Say a sentence, and where the cross is; null says only that, once the cross rests. */
  say(sentence) {
    clearTimeout(this.resting);
    if (sentence === null) this.resting = setTimeout(() => this.tell(this.drawing.describe(this.at)), REST_MS);
    else this.tell(sentence);
  }

  tell(sentence) {
    this.words.textContent = sentence;
  }
}
