// Asks for a key when the token of the link has expired, or there was none.

import { onKeyNeeded, storedKey } from "../api.js";
import { byId } from "../dom.js";
import { say } from "./words.js";

let asking = null;

export function setUpKey() {
  const dialog = byId("key-dialog");
  byId("key-cancel").addEventListener("click", () => dialog.close(""));
  byId("key-form").addEventListener("submit", (event) => {
    event.preventDefault();
    dialog.close(byId("key").value.trim());
  });
  onKeyNeeded(() => {
    asking ??= ask(dialog).finally(() => {
      asking = null;
    });
    return asking;
  });
}

function ask(dialog) {
  storedKey.forget();
  byId("key-reason").textContent = say("key.words");
  byId("key").value = "";
  dialog.returnValue = "";
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => resolve(dialog.returnValue || null), { once: true });
  });
}
