// The plan as the studio's board draws it, with its placing of names, and a dot with its trail.

import { svg } from "/assets/js/dom.js";
import { Board } from "/assets/js/studio/board.js";
import { drawn, get, pan, walk } from "./common.js";

const [plan, features] = await Promise.all([get("plan.json"), get("features.json")]);
const board = new Board();
board.show({ url: "plan.png", width: plan.width, height: plan.height, metersPerPixel: plan.meters_per_pixel, origin: plan.origin_px });
const picture = board.ground.querySelector("image");
await new Promise((resolve) => picture.addEventListener("load", resolve));
board.use({
  draw() {
    const shapes = features.features.map(({ geometry: { type, coordinates }, properties: { kind, name } }) => {
      if (type === "Polygon") return svg("polygon", { points: board.line(coordinates[0]), class: kind });
      return board.glyph(coordinates, svg("circle", { r: 7, class: kind }), svg("text", { x: 10, y: 4 }, name ?? ""));
    });
    board.layer.append(...shapes);
  },
});
const trail = svg("polyline", { class: "route" });
const dot = svg("circle", { r: 10, class: "pin" });
board.svg.append(trail, dot);
const passed = [];

function move(x, y) {
  passed.push([x, y]);
  trail.setAttribute("points", board.line(passed));
  const [u, v] = board.units([x, y]);
  Object.assign(board.viewport.view, { x: u, y: v });
  board.viewport.following = false;
  board.viewport.apply();
  dot.setAttribute("transform", `translate(${u} ${v}) scale(${board.viewport.unitsPerPx})`);
}

window.drawing = {
  drawnMs: await drawn(),
  closeUp: () => board.viewport.zoom(4),
  walk: (seconds) => walk(plan.walk, move, seconds),
  pan: (seconds) => pan((dx, dy) => board.viewport.move(dx, dy), seconds),
};
