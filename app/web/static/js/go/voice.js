// Speaks instructions, each once, when the person wants that.

import { language } from "./words.js";

const REMEMBERED = "roomfix.voice";

export class Voice {
  constructor(button) {
    this.button = button;
    this.on = localStorage.getItem(REMEMBERED) === "on";
    this.said = null;
    button.hidden = !("speechSynthesis" in globalThis);
    button.addEventListener("click", () => this.toggle(!this.on));
    this.show();
  }

  toggle(on) {
    this.on = on;
    localStorage.setItem(REMEMBERED, on ? "on" : "off");
    this.show();
    if (!on) globalThis.speechSynthesis?.cancel();
    else if (this.last) this.speak(this.last);
  }

  show() {
    this.button.setAttribute("aria-pressed", String(this.on));
  }

  /** Say a sentence unless what it is about, `topic`, was said last. */
  say(topic, sentence) {
    this.last = sentence;
    if (topic === this.said) return;
    this.said = topic;
    if (this.on) this.speak(sentence);
  }

  speak(sentence) {
    const speech = globalThis.speechSynthesis;
    if (!speech) return;
    speech.cancel();
    const spoken = new SpeechSynthesisUtterance(sentence);
    spoken.lang = language();
    speech.speak(spoken);
  }
}
