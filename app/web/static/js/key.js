// The key: asked for when the server wants one, kept in this tab only.

import { onKeyNeeded, storedKey } from "./api.js";
import { byId } from "./dom.js";

let asking = null;

export function setUpKey() {
  const dialog = byId("key-dialog");
  byId("key-cancel").addEventListener("click", () => dialog.close(""));
  byId("key-form").addEventListener("submit", (event) => {
    event.preventDefault();
    dialog.close(byId("key").value.trim());
  });
  byId("forget-key").addEventListener("click", () => {
    storedKey.forget();
    location.reload();
  });
  // Several calls may be refused at once; the question is asked once.
  onKeyNeeded((reason) => {
    asking ??= ask(dialog, reason).finally(() => {
      asking = null;
    });
    return asking;
  });
  showForget();
}

function ask(dialog, reason) {
  const refused = storedKey.get() !== null;
  byId("key-reason").textContent = refused ? `The key was refused. ${reason}` : reason;
  byId("key").value = "";
  dialog.returnValue = "";
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener(
      "close",
      () => {
        resolve(dialog.returnValue || null);
        byId("forget-key").hidden = !dialog.returnValue;
      },
      { once: true },
    );
  });
}

function showForget() {
  byId("forget-key").hidden = storedKey.get() === null;
}
