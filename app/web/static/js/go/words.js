// What a page says, from catalogue files for each language: languages/go/{language}.json, and a folder of its own.

import { requestJson } from "../api.js";
import { turns } from "../turns.js";

const REMEMBERED = "roomfix.language";
const FALLBACK = "en";
let catalogue = {};
let folders = ["go"];
let current = FALLBACK;
const turn = turns();

/** Load the language that was chosen before, or else the first of the browser's that there is; return all tags.
 *
 * `own` is the folder of further sentences of the page.
 */
export async function loadWords(own = null) {
  if (own) folders = ["go", own];
  const available = await requestJson("assets/languages");
  const asked = new URLSearchParams(location.search).get("language");
  const wanted = [asked, localStorage.getItem(REMEMBERED), ...navigator.languages];
  const tags = wanted.filter(Boolean).map((tag) => tag.toLowerCase().split("-")[0]);
  await chooseLanguage(tags.find((tag) => available.includes(tag)) ?? FALLBACK);
  return available;
}

/** Change to a language; returns whether it is the one that was chosen last. */
export async function chooseLanguage(tag) {
  const isLatest = turn();
  const tags = tag === FALLBACK ? [FALLBACK] : [FALLBACK, tag];
  const files = tags.flatMap((each) => folders.map((folder) => `assets/languages/${folder}/${each}.json`));
  const sentences = await Promise.all(files.map((file) => requestJson(file)));
  if (!isLatest()) return false;
  catalogue = Object.assign({}, ...sentences);
  current = tag;
  document.documentElement.lang = tag;
  return true;
}

/** Remember a language that the person chose. */
export const rememberLanguage = (tag) => localStorage.setItem(REMEMBERED, tag);

export const language = () => current;

/** Return a sentence with its {names} filled in. */
export function say(key, values = {}) {
  return (catalogue[key] ?? key).replace(/\{(\w+)\}/g, (_, name) => String(values[name] ?? ""));
}

/** Whether there is a sentence of this key. */
export const knows = (key) => key in catalogue;

/** Return metres as people read them: half metres below 3, whole ones above. */
export function metres(value) {
  const rounded = value < 3 ? Math.round(value * 2) / 2 : Math.round(value);
  return rounded.toLocaleString(current);
}
