// Saves through cuts: while the server can't be reached the person is told so, and it is tried again until it is back.

import { byId, showError } from "../dom.js";

const EVERY_MS = 1000;
const LOST = "The server can't be reached. What you did is kept in this browser and saved as soon as the server is back.";

/** Run an action that stores something of the shown floor, again and again while nobody answers; other errors are thrown.
 * What was meant for a floor that is left meanwhile stays its draft: it is not stored on another floor. */
export async function surely(floors, action) {
  const { place } = floors;
  while (floors.place === place) {
    try {
      return await action();
    } catch (error) {
      if (error.status !== 0 && error.status !== 503) throw error;
      if (floors.place === place) showError(byId("board-error"), new Error(LOST));
      await new Promise((resolve) => setTimeout(resolve, EVERY_MS));
    }
  }
  return undefined;
}
