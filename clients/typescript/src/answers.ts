// What the server answers: the JSON as it is.

export type Axes = "opencv" | "arkit" | "arcore" | "webxr" | "unity" | "unreal" | "ros";
export type Reason = "no_match" | "too_few_inliers" | "ambiguous" | "outside_venue" | "poor_image" | "no_map";
export type Tracking = "initializing" | "tracking" | "relocalized" | "lost";

/** A point in metres (centimetres with axes "unreal"). */
export interface Position {
  x: number;
  y: number;
  z: number;
}

/** A unit quaternion, scalar last. */
export interface Quaternion extends Position {
  w: number;
}

/** A pose; that of an answer is world_from_camera. */
export interface Pose {
  position: Position;
  quaternion: Quaternion;
}

/** A point on the floor plan: metres, degrees counter-clockwise from plan x, pixels of the plan image. */
export interface Plan {
  x: number;
  y: number;
  heading_deg: number;
  u_px: number | null;
  v_px: number | null;
  area: string | null;
  area_name: string | null;
  nearest_landmark: string | null;
  nearest_landmark_name: string | null;
  nearest_landmark_m: number | null;
}

/** One sigma. */
export interface Accuracy {
  position_m: number;
  orientation_deg: number;
}

/** Intrinsics by COLMAP's names, and where they come from. */
export interface Camera {
  model: string;
  width: number;
  height: number;
  params: number[];
  source: string | null;
}

/** A keyframe that agrees with the pose. */
export interface Keyframe {
  keyframe: number;
  matches: number;
  inliers: number;
}

/** Matches that agree with the pose: u, v of the image, then u, v of the keyframe's picture. */
export interface ShownMatches {
  keyframe: number;
  pairs: number[][];
}

/** A position in WGS 84: degrees, and metres above the ellipsoid. */
export interface GeoPosition {
  lat: number;
  lon: number;
  h: number;
}

/** Degrees: yaw counter-clockwise from east, pitch downwards, roll to the right; turns about z, y, x in turn. */
export interface YawPitchRoll {
  yaw: number;
  pitch: number;
  roll: number;
}

/** A GeoPose 1.0: the camera's body (x forward, y left, z up) against east, north and up at its position. */
export interface GeoPose {
  position: GeoPosition;
  quaternion: Quaternion;
  angles: YawPitchRoll;
}

/** Where plan (0, 0) of a floor lies on Earth; `heading_deg` is the compass bearing of plan y. */
export interface Origin {
  latitude: number;
  longitude: number;
  height_m: number;
  heading_deg: number;
  floor: string | null;
}

/** The support of the pose by one frame of a query that has several. */
export interface FrameSupport {
  inliers: number;
  matches: number;
}

/** Where the camera is, or the reason why that can't be said. */
export interface LocateResult {
  located: boolean;
  reason: Reason | null;
  method: string;
  venue: string;
  map_version: number | null;
  floor: string | null;
  pose: Pose | null;
  plan: Plan | null;
  plan_reason: "up_unknown" | "scale_unknown" | null;
  accuracy: Accuracy | null;
  confidence: number;
  inliers: number;
  matches: number;
  keyframes: Keyframe[];
  camera: Camera | null;
  narrowed: boolean;
  gravity_checked: boolean | null;
  timings_ms: Record<string, number>;
  anchors: string[];
  vertical: "gravity" | "pois" | "upright" | "map" | null;
  axes: Axes;
  session_from_world: Pose | null;
  hints: string[];
  shown_matches: ShownMatches | null;
  geopose: GeoPose | null;
  geopose_reason: "no_origin" | "up_unknown" | "scale_unknown" | "plan_unknown" | null;
  frames: FrameSupport[];
}

/** One frame of a trajectory. */
export interface TrajectoryPoint {
  frame: number;
  time_s: number;
  tracking: Tracking;
  floor: string | null;
  x: number | null;
  y: number | null;
  heading_deg: number | null;
  pose: Pose | null;
  position_m: number | null;
}

/** What a walker does next; which fields there are depends on `problem`. */
export interface SessionGuidance {
  instruction?: string | null;
  turn?: string | null;
  distance_m?: number | null;
  remaining_m?: number | null;
  off_route?: boolean;
  arrived?: boolean;
  landmark?: string | null;
  along_m?: number | null;
  bearing_deg?: number | null;
  planned?: boolean;
  problem?: "lost" | "no_route" | "off_network" | null;
  detail?: string | null;
  go_on_m?: number | null;
}

/** The answer to a frame of a session. */
export interface TrackedFrame extends LocateResult {
  session: string;
  frame: number;
  tracking: Tracking;
  unaided_m: number;
  trajectory: TrajectoryPoint[];
  guidance: SessionGuidance | null;
}

/** A session and where it went. */
export interface Session {
  session: string;
  venue: string;
  camera: unknown;
  destination: string | null;
  language: string | null;
  share: boolean;
  tracking: Tracking;
  frames: number;
  created_at: string;
  expires_at: string;
  trajectory: TrajectoryPoint[];
}

/** A build as it is now. */
export interface Build {
  build: string;
  venue: string;
  kind: "scan" | "recording" | "pictures";
  priority: number;
  state: "queued" | "running" | "succeeded" | "failed" | "cancelled";
  stage: string | null;
  done: number;
  total: number;
  attempts: number;
  error: string | null;
  error_code: string | null;
  report: Record<string, unknown> | null;
  map_version: number | null;
  created_at: string | null;
  started_at: string | null;
  finished_at: string | null;
}

/** What a scan holds and what a build would do with it. */
export interface Inspection {
  recognised: Record<string, unknown>[];
  format: string;
  frames: number;
  discarded: Record<string, number>;
  sensors: Record<string, unknown>;
  duration_s: number;
  rate_hz: number | null;
  trajectory: Record<string, unknown> | null;
  examination: Record<string, unknown> | null;
  loops: Record<string, unknown> | null;
  build: Record<string, unknown>;
  notes: string[];
  path_svg: string | null;
}

/** A venue that the key may use; `map_version` is null before its first build. */
export interface Venue {
  id: string;
  name: string;
  created_at: string;
  map_version: number | null;
  origin: Origin | null;
}

/** A short-lived token for a phone; `key` is the id of the key that made it. */
export interface CreatedToken {
  token: string;
  key: string;
  venue: string;
  expires_at: string;
}

/** What became of a monitoring camera's frame. */
export interface PushedFrame {
  frame: string;
  features: number;
  pois_visible: string[];
  received_at: string;
}

/** An error as RFC 9457 describes it, with a stable code; of a stream, with the number of its frame. */
export interface Problem {
  type: string;
  title?: string;
  status: number;
  code: string;
  detail: string;
  received?: number | null;
}
