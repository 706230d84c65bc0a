// The choice of a language, by its own name.

import { byId, el } from "../dom.js";
import { chooseLanguage, language, rememberLanguage } from "./words.js";

/** Fill the list of languages; `onChange` is called with the one that was chosen. */
export function showLanguages(available, onChange) {
  const select = byId("language");
  const names = new Intl.DisplayNames(["en"], { type: "language" });
  const own = (tag) => new Intl.DisplayNames([tag], { type: "language" }).of(tag) ?? names.of(tag);
  select.replaceChildren(...available.map((tag) => el("option", { value: tag, lang: tag }, own(tag))));
  select.value = language();
  select.addEventListener("change", async () => {
    const tag = select.value;
    try {
      if (!(await chooseLanguage(tag))) return;
      rememberLanguage(tag);
      onChange(tag);
    } catch {
      // The sentences can't be read now: the page goes on in the language that it has.
      if (select.value === tag) select.value = language();
    }
  });
}
