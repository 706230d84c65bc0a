// Choosing the photo: from files, the camera, a drop or the clipboard.

import { byId } from "./dom.js";
import { bytes } from "./words.js";

/** Call `onPhoto` with each image that is chosen. */
export function setUpPhoto(onPhoto) {
  const choose = (file) => {
    if (!file) return;
    preview(file);
    onPhoto(file);
  };
  for (const id of ["photo", "take"]) {
    byId(id).addEventListener("change", (event) => choose(event.target.files[0]));
  }
  // On a desktop, "take" would open the same dialog as "choose".
  byId("take-label").hidden = !matchMedia("(pointer: coarse)").matches;
  setUpDrop(choose);
  addEventListener("paste", (event) => {
    if (!byId("view-locate").hidden) choose(imageOf(event.clipboardData));
  });
}

function setUpDrop(choose) {
  const drop = byId("drop");
  drop.addEventListener("click", () => byId("photo").click());
  // Also beside the box: the browser would leave the page to show a photo that misses it.
  addEventListener("dragover", (event) => {
    event.preventDefault();
    drop.classList.add("over");
  });
  addEventListener("dragleave", (event) => {
    if (event.relatedTarget === null) drop.classList.remove("over");
  });
  addEventListener("drop", (event) => {
    event.preventDefault();
    drop.classList.remove("over");
    if (!byId("view-locate").hidden) choose(imageOf(event.dataTransfer));
  });
}

function imageOf(transfer) {
  return [...transfer.files].find((file) => file.type.startsWith("image/"));
}

function preview(file) {
  const image = byId("preview");
  if (image.src) URL.revokeObjectURL(image.src);
  image.src = URL.createObjectURL(file);
  image.hidden = false;
  byId("drop-words").hidden = true;
  byId("file-name").hidden = false;
  byId("file-name").textContent = `${file.name}, ${bytes(file.size)}`;
}
