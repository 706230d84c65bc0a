// Saves through cuts: while the server can't be reached the person is told so, and it is tried again until it is back.

import { showError } from "../dom.js";

const EVERY_MS = 1000;
const LOST = "The server can't be reached. What you did is kept in this browser and saved as soon as the server is back.";

/** Run an action that stores something, again and again while nobody answers; other errors are thrown. */
export async function surely(place, action) {
  for (;;) {
    try {
      return await action();
    } catch (error) {
      if (error.status !== 0 && error.status !== 503) throw error;
      showError(place, new Error(LOST));
      await new Promise((resolve) => setTimeout(resolve, EVERY_MS));
    }
  }
}
