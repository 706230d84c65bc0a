// Names on the board that can be read: one that would lie over another name, or on a point, goes to the other side of its
// own point, or is left out until zooming makes room for it.

// Room between two names.
const GAP_PX = 2;

/** Place the texts of a layer for what a box shows of it. What is chosen comes first and is always named; then as it is drawn. */
export function placeLabels(layer, box) {
  const texts = [...layer.querySelectorAll("text")];
  for (const text of texts) reset(text);
  const shown = box.getBoundingClientRect();
  // All are measured before the first is changed: the browser then lays them out once.
  const measured = texts.map((text) => ({ text, isChosen: isOfChosen(text, layer), sides: sidesOf(text) }));
  const marks = [...layer.querySelectorAll("circle, rect")].map((mark) => ({ node: mark.parentNode, place: mark.getBoundingClientRect() }));
  const taken = [];
  const isFree = (place, node) => !taken.some((other) => overlap(place, other)) && !marks.some((mark) => mark.node !== node && overlap(place, mark.place));
  for (const { text, isChosen, sides } of measured.sort((a, b) => b.isChosen - a.isChosen)) {
    const free = sides.findIndex((place) => isInside(place, shown) && isFree(place, text.parentNode));
    const side = free < 0 && isChosen ? 0 : free;
    if (side < 0) text.setAttribute("visibility", "hidden");
    else taken.push(sides[side]);
    if (side === 1) turn(text);
  }
}

/** A text stands in the group of its point, and that of an area's name in the area's. */
function isOfChosen(text, layer) {
  const groups = [text.parentNode, text.parentNode.parentNode].filter((group) => layer.contains(group) && group !== layer);
  return groups.some((group) => group.querySelector(":scope > .chosen") !== null);
}

function reset(text) {
  text.removeAttribute("visibility");
  if (text.dataset.turned) turn(text);
}

/** Move a text to the other side of its point. */
function turn(text) {
  text.setAttribute("x", -Number(text.getAttribute("x")));
  if (text.dataset.turned) {
    delete text.dataset.turned;
    text.removeAttribute("text-anchor");
  } else {
    text.dataset.turned = "yes";
    text.setAttribute("text-anchor", "end");
  }
}

/** Return where a text can be on the screen: as it is, and beyond its point unless it is centred there. */
function sidesOf(text) {
  const { left, right, top, bottom } = text.getBoundingClientRect();
  const here = { left, right, top, bottom };
  if (text.hasAttribute("text-anchor")) return [here];
  const shift = right - left + 2 * Number(text.getAttribute("x"));
  return [here, { ...here, left: left - shift, right: right - shift }];
}

const isInside = (a, b) => a.left >= b.left && a.right <= b.right && a.top >= b.top && a.bottom <= b.bottom;

const overlap = (a, b) =>
  a.left < b.right + GAP_PX && b.left < a.right + GAP_PX && a.top < b.bottom + GAP_PX && b.top < a.bottom + GAP_PX;
