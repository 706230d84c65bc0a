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
    await chooseLanguage(select.value);
    rememberLanguage(select.value);
    onChange(select.value);
  });
}
