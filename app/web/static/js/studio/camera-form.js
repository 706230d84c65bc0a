// A monitoring camera as the form has it, and as the server has it.

export const EMPTY = {
  id: "",
  x: "",
  y: "",
  height: "2.5",
  intrinsics: "",
  keep: false,
  pois: [],
  place: null,
  name: "",
  region: "",
  distance: "",
  // What the form doesn't show, and must not lose.
  more: {},
};
const ID = /^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$/;

/** Return the form of a camera that the server has. */
export function formOf(anchor) {
  const { camera, position, heading_deg, max_age_s } = anchor;
  return {
    ...EMPTY,
    id: anchor.id,
    x: String(position.x),
    y: String(position.y),
    height: String(anchor.height_m),
    intrinsics: Array.isArray(camera) ? camera.join(", ") : JSON.stringify(camera),
    keep: anchor.store_images,
    pois: anchor.pois,
    more: { heading_deg, max_age_s },
  };
}

/** Return the body that stores a form's camera; throws with what is missing. */
export function bodyOf(form, venue, floor) {
  if (!ID.test(form.id)) throw new Error("The camera needs an id of letters, digits, dot, dash and underscore.");
  if (form.x === "" || form.y === "") throw new Error("Click where the camera hangs, on the plan.");
  if (form.height === "") throw new Error("The camera's height above the floor is missing.");
  if (!form.intrinsics) throw new Error("The lens is missing: type its four numbers, or find them by the map.");
  if (!form.pois.length) throw new Error("Add at least one place that the camera sees.");
  return {
    ...form.more,
    venue,
    floor,
    position: { x: Number(form.x), y: Number(form.y) },
    height_m: Number(form.height),
    camera: statedCamera(form.intrinsics),
    pois: form.pois,
    store_images: form.keep,
  };
}

/** Return the place that the form's fields describe; throws with what is missing. */
export function placeOf({ name, region, place, distance }) {
  const corners = cornersOf(region);
  if (!ID.test(name)) throw new Error("The place needs an id of letters, digits, dot, dash and underscore.");
  if (!corners) throw new Error("Click two corners of the place in the picture first.");
  if (!place) throw new Error("Press The place, and click where it is on the plan.");
  if (!(Number(distance) > 0)) throw new Error("The place needs its distance from the camera.");
  const [a, b, c, d] = corners;
  const rectangle = [[a, b], [c, b], [c, d], [a, d]];
  return { id: name, region_px: rectangle, position: { x: place[0], y: place[1] }, distance_m: Number(distance) };
}

/** Return the four numbers of a region's corners, null where there are none. */
export function cornersOf(text) {
  const numbers = text.split(",").map((part) => (part.trim() === "" ? Number.NaN : Number(part)));
  return numbers.length === 4 && numbers.every(Number.isFinite) ? numbers : null;
}

/** Return the width of the pictures that the intrinsics are for, null where they don't say. */
export function statedWidth(intrinsics) {
  try {
    return statedCamera(intrinsics).width ?? null;
  } catch {
    return null;
  }
}

/** Return intrinsics as the field shows them: four numbers of a pinhole camera, else all of it. */
export function intrinsicsText({ model, width, height, params }) {
  const round = (value) => Number(value.toFixed(1));
  if (model === "PINHOLE") return params.map(round).join(", ");
  if (model === "SIMPLE_PINHOLE") return [params[0], ...params].map(round).join(", ");
  return JSON.stringify({ model, width, height, params });
}

function statedCamera(text) {
  if (!text.trim().startsWith("{")) return text.trim();
  try {
    return JSON.parse(text);
  } catch {
    throw new Error("The lens is neither four numbers nor JSON.");
  }
}
