// Numbers, times and the server's terms in words that people use.

const REASONS = {
  no_map: ["This venue has no map yet.", "Build one from a scan first."],
  no_match: [
    "Nothing in the map looks like this photo.",
    "It may show a place that was not scanned, or that has changed since. Try a view with furniture, signs or pictures in it.",
  ],
  too_few_inliers: [
    "Parts of the photo resemble the map, but too few of them agree on one place.",
    "A wrong place would be worse than none. Step back, so that more of the room is in view.",
  ],
  ambiguous: [
    "More than one place in this venue looks like this photo.",
    "Include something that only this place has, such as a door sign, or choose the floor.",
  ],
  outside_venue: [
    "The place that was found is outside the venue's floors.",
    "If the photo was taken inside, check the heights of the floors.",
  ],
  poor_image: [
    "There is too little to see in the photo.",
    "It is too dark, too blurred, or shows a bare wall. Hold still, and aim at something with detail.",
  ],
};

const STAGES = {
  decode: "Read photo",
  describe: "Describe",
  retrieve: "Find keyframes",
  match: "Match",
  pose: "Compute pose",
  verify: "Verify",
  focal: "Search focal length",
};

const BUILD_STAGES = {
  upload: "Uploading the scan",
  start: "Starting",
  unpack: "Unpacking",
  read: "Reading the scan",
  examine: "Examining the scan",
  describe_places: "Looking at the places of the scan",
  join_parts: "Joining the parts of the path",
  find_loops: "Looking for places that were passed twice",
  close_loops: "Correcting drift",
  find_features: "Looking for features",
  match_frames: "Matching pictures with each other",
  measure_motions: "Measuring how the camera moved",
  adjust_structure: "Adjusting the path and its points",
  hold_to_depth: "Fitting the path to the depth images",
  find_marker: "Looking for the marker",
  find_scale: "Finding the scale",
  find_up: "Finding which way is up",
  register: "Finding its place in the present map",
  calibrate: "Fitting the thresholds of keyframes",
  compare: "Comparing frames",
  quality: "Looking for blurred frames",
  select: "Choosing keyframes",
  describe: "Describing keyframes",
  check_lens: "Looking for the lens",
  check_sensor: "Checking the depth sensor",
  triangulate: "Triangulating points",
  refine: "Refining depth",
  add_features: "Adding features of the frames between keyframes",
  distinguish: "Looking for places that look alike",
  "second features": "Describing keyframes a second time",
  "match pairs": "Matching keyframes with each other",
  index: "Indexing",
  verify: "Checking the map against its own scan",
  store: "Storing",
  publish: "Publishing",
};

/** Return [what is the matter, what helps] for a reason of the server. */
export function reasonWords(reason) {
  return REASONS[reason] ?? [`The photo could not be placed (${reason}).`, "Try another view."];
}

export const stageWords = (stage) => STAGES[stage] ?? humanize(stage);
export const buildStageWords = (stage) => BUILD_STAGES[stage] ?? humanize(stage);

// What a decomposition of Unicode would lose, or write other than the languages themselves do.
const LETTERS = {
  ä: "ae", ö: "oe", ü: "ue", ß: "ss", æ: "ae", œ: "oe", ø: "oe", å: "aa", ł: "l", đ: "d", ð: "d", þ: "th", ı: "i",
};

/** Return a text with umlauts as two letters and other letters without their marks, for ids that stay readable. */
export function transliterated(text) {
  const plain = text.normalize("NFC").replace(/\p{L}/gu, (letter) => LETTERS[letter.toLowerCase()] ?? letter);
  return plain.normalize("NFKD").replace(/\p{M}/gu, "");
}

function humanize(name) {
  const words = String(name).replaceAll("_", " ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}

export function metres(value) {
  if (Math.abs(value) < 0.995) return `${(value * 100).toFixed(Math.abs(value) < 0.0995 ? 1 : 0)} cm`;
  return `${value.toFixed(value < 10 ? 2 : 1)} m`;
}

export function degrees(value, digits = 1) {
  return `${value.toFixed(digits)}°`;
}

export function milliseconds(value) {
  return value < 1000 ? `${value < 10 ? value.toFixed(1) : Math.round(value)} ms` : `${(value / 1000).toFixed(2)} s`;
}

export function seconds(value) {
  if (value < 90) return `${value < 10 ? value.toFixed(1) : Math.round(value)} s`;
  return `${Math.floor(value / 60)} min ${Math.round(value % 60)} s`;
}

export function bytes(value) {
  const units = ["B", "kB", "MB", "GB"];
  const power = Math.min(units.length - 1, Math.floor(Math.log10(Math.max(1, value)) / 3));
  const scaled = value / 1000 ** power;
  return `${scaled < 10 && power > 0 ? scaled.toFixed(1) : Math.round(scaled)} ${units[power]}`;
}

export const count = (value) => Number(value).toLocaleString("en");

export function moment(text) {
  return new Date(text).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });
}
