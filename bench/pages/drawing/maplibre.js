// The same plan by MapLibre GL JS: the picture as an image source, features, dot and trail as layers.

import * as maplibregl from "/maplibre/dist/maplibre-gl.mjs";
import { drawn, get, pan, walk } from "./common.js";

// Metres are laid out around latitude 0, where a degree is this long.
const METRES_A_DEGREE = 111_319.49;
const place = ([x, y]) => [x / METRES_A_DEGREE, y / METRES_A_DEGREE];

maplibregl.setWorkerUrl?.("/maplibre/dist/maplibre-gl-worker.mjs");
const [plan, features] = await Promise.all([get("plan.json"), get("features.json")]);
const { width, height, meters_per_pixel: m, origin_px: [u0, v0] } = plan;
const corner = (u, v) => place([(u - u0) * m, (v0 - v) * m]);
const corners = [corner(0, 0), corner(width, 0), corner(width, height), corner(0, height)];
for (const { geometry } of features.features) {
  geometry.coordinates = geometry.type === "Point" ? place(geometry.coordinates) : geometry.coordinates.map((ring) => ring.map(place));
}
const collection = (...geometries) => ({ type: "FeatureCollection", features: geometries.map((geometry) => ({ type: "Feature", properties: {}, geometry })) });
const map = new maplibregl.Map({
  container: "board",
  attributionControl: false,
  bounds: [corners[3], corners[1]],
  style: {
    version: 8,
    sources: {
      plan: { type: "image", url: new URL("plan.png", location).href, coordinates: corners },
      features: { type: "geojson", data: features },
      trail: { type: "geojson", data: collection() },
      dot: { type: "geojson", data: collection() },
    },
    layers: [
      { id: "plan", type: "raster", source: "plan" },
      { id: "areas", type: "fill", source: "features", filter: ["==", ["get", "kind"], "area"], paint: { "fill-color": "#0a62d0", "fill-opacity": 0.1 } },
      { id: "landmarks", type: "circle", source: "features", filter: ["==", ["get", "kind"], "landmark"], paint: { "circle-radius": 7, "circle-color": "#0a62d0" } },
      { id: "names", type: "symbol", source: "features", filter: ["==", ["get", "kind"], "landmark"], layout: { "text-field": ["get", "name"], "text-size": 13, "text-anchor": "left", "text-offset": [0.8, 0] } },
      { id: "trail", type: "line", source: "trail", paint: { "line-color": "#14703f", "line-width": 4 } },
      { id: "dot", type: "circle", source: "dot", paint: { "circle-radius": 10, "circle-color": "#b02318" } },
    ],
  },
});
map.on("error", ({ error }) => console.error(error.message));
await new Promise((resolve) => map.once("idle", resolve));
const passed = [];

function move(x, y) {
  passed.push(place([x, y]));
  if (passed.length > 1) map.getSource("trail").setData(collection({ type: "LineString", coordinates: passed }));
  map.getSource("dot").setData(collection({ type: "Point", coordinates: place([x, y]) }));
  map.jumpTo({ center: place([x, y]) });
}

window.drawing = {
  drawnMs: await drawn(),
  closeUp: () => map.zoomTo(map.getZoom() + 2, { animate: false }),
  walk: (seconds) => walk(plan.walk, move, seconds),
  pan: (seconds) => pan((dx, dy) => map.panBy([-dx, -dy], { animate: false }), seconds),
};
