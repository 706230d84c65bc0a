// Starts the studio: key, venues, the board with its tools, and the views that the address's fragment chooses between.

import { byId, showError } from "../dom.js";
import { setUpKey } from "../key.js";
import { turns } from "../turns.js";
import { currentVenue, loadVenues, onVenueChange, setUpVenues } from "../venues.js";
import { AlignTool } from "./align.js";
import { Board } from "./board.js";
import { CameraTool } from "./cameras.js";
import { DrawTool } from "./draw.js";
import { Floors } from "./floors.js";
import { PhonesTool } from "./phones.js";
import { forgetPhoto, setUpPhoto } from "./photo.js";
import { PlanTool } from "./plan.js";
import { Scans } from "./scans.js";
import { chooseRecording, forgetCode, setUpShare, showShare } from "./share.js";
import { forgetSteps, showSteps } from "./steps.js";

// View -> [title, words, panel] of those that use the board; the others have a section of their own.
const BOARD_VIEWS = {
  plan: ["The floor plan", "Choose a picture of the plan, then tell its scale.", "plan-panel"],
  align: ["Scan over plan", "Lay the scan, seen from above, over the plan. The numbers do the same as the mouse.", "align-panel"],
  draw: ["Places and ways", "What people can go to, and where they can walk.", "draw-panel"],
  cameras: ["Monitoring cameras", "A camera that hangs somewhere can say where a phone is that sees the same.", "camera-panel"],
  phones: ["Live phones", "Phones whose owners agreed to be shown, crosses where they could not be located, and where the map locates one.", "phones-panel"],
};
const VIEWS = ["start", "scan", ...Object.keys(BOARD_VIEWS), "try", "share"];
// View with the board -> the view that the link below its panel leads to.
const NEXT = { plan: "align", align: "draw", draw: "cameras", cameras: "try", phones: "share" };

const board = new Board();
const stored = () => {};
const floors = new Floors(board, () => beginTool());
const tools = {
  plan: new PlanTool(board, floors, stored),
  align: new AlignTool(board, floors, stored),
  draw: new DrawTool(board, floors, stored),
  cameras: new CameraTool(board, floors, stored),
  phones: new PhonesTool(board, floors),
};
const scans = new Scans(() => showView());
const RETRY_MS = 2000;
const viewTurn = turns();
const venueTurn = turns();
// Whether the floors of the chosen venue are on their way.
let loading = false;

function currentView() {
  const name = location.hash.slice(1);
  return VIEWS.includes(name) ? name : "start";
}

/** Let the keyboard go on, and screen readers read on, from the title of the view. */
function focusView() {
  const view = currentView();
  byId(view in BOARD_VIEWS ? "title-board" : `title-${view}`).focus({ preventScroll: true });
}

async function showView() {
  viewTurn();
  const view = currentView();
  const onBoard = view in BOARD_VIEWS;
  for (const name of ["start", "scan", "try", "share"]) byId(`view-${name}`).hidden = name !== view;
  byId("view-board").hidden = !onBoard;
  if (!onBoard) board.use(null);
  for (const [name, [, , panel]] of Object.entries(BOARD_VIEWS)) byId(panel).hidden = name !== view;
  for (const link of document.querySelectorAll(".bar nav a")) {
    if (link.getAttribute("href") === `#${view}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  if (view === "start") await (loading ? null : showSteps(floors));
  else if (view === "scan") await scans.show();
  else if (view === "share") await showShare();
  else if (onBoard) {
    [byId("title-board").textContent, byId("board-lead").textContent] = BOARD_VIEWS[view];
    const next = document.querySelector(`.bar nav a[href="#${NEXT[view]}"]`);
    Object.assign(byId("next-of-board"), { href: next.hash, textContent: `Next: ${next.textContent}` });
    board.viewport.fit();
    await beginTool();
  }
}

async function beginTool() {
  const view = currentView();
  if (!(view in BOARD_VIEWS)) return;
  const isLatest = viewTurn();
  const tool = tools[view];
  const panel = byId(BOARD_VIEWS[view][2]);
  const focused = panel.contains(document.activeElement) ? document.activeElement : null;
  // What is clicked before the tool has what it works on would be lost, or be stored on another floor.
  panel.inert = true;
  board.use(null);
  if (loading || floors.isLoading) return;
  byId("board-error").replaceChildren();
  try {
    await tool.begin(isLatest);
    if (!isLatest()) return;
    board.use(tool);
    panel.inert = floors.current === null;
    // The keyboard keeps its place.
    if (focused?.isConnected && document.activeElement === document.body) focused.focus();
  } catch (error) {
    if (!isLatest()) return;
    showError(byId("board-error"), error);
    // The server can't be reached: what this view shows is read as soon as it is back.
    if (error.status === 0) setTimeout(() => isLatest() && beginTool(), RETRY_MS);
  }
}

async function venueChanged() {
  showError(byId("page-error"), null);
  const venue = currentVenue()?.id ?? null;
  const isSame = !loading && !floors.isLoading && floors.venue === venue;
  // The list of venues was read again: what is being done on a floor goes on, unless another map serves now.
  if (isSame && currentView() in BOARD_VIEWS && currentView() !== "align") return;
  const isLatest = venueTurn();
  if (!isSame) for (const forget of [forgetSteps, forgetPhoto, forgetCode, () => scans.forget()]) forget();
  loading = true;
  try {
    if (!isSame) await floors.loadSurely();
    if (!isLatest()) return;
    loading = false;
    await showView();
  } catch (error) {
    if (isLatest()) showError(byId("page-error"), error);
  }
}

setUpKey();
setUpVenues();
setUpPhoto(floors);
setUpShare();
byId("film-scan").addEventListener("click", () => {
  chooseRecording();
  location.hash = "#share";
});
onVenueChange(venueChanged);
addEventListener("hashchange", () => {
  showView().catch((error) => showError(byId("page-error"), error));
  focusView();
  scrollTo(0, 0);
});
// The fragment stays that of the view.
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault();
  focusView();
});
// Enter or Space at a tool, of which no pointer tells a number of clicks, goes on to the plan, where the tool is used.
byId("view-board").addEventListener("click", (event) => {
  if (event.detail === 0 && event.target.closest("[data-tool]")) board.box.focus();
});
loadVenues().catch((error) => showError(byId("page-error"), error));
