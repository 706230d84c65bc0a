"""Pairs of frames of a recorded scan as monitoring camera and phone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import AnchorSpec, Poi
from app.engine.mapping.frame_images import frame_rgb
from app.errors import InvalidInputError
from app.geometry.camera import Camera
from app.geometry.camera_hint import hint_of
from app.geometry.se3 import rotation_between
from app.importers.frames import Frame, Scan
from app.vision.images import Rgb, to_gray
from bench.anchors.features import PosedPictures
from bench.anchors.pairs import AnchorPair

Array = NDArray[np.float64]

MIN_BASELINE_M = 0.3
MAX_BASELINE_M = 4.0
MIN_AXES_COSINE = float(np.cos(np.radians(45.0)))
REGION_HALF_PX = 60
MAX_DEPTH_DIFFERENCE = 0.1
MARGIN_PX = 40
TRIES_PER_PAIR = 200
TRIES_PER_POI = 10
# Half the side of the square around the middle of a thing that catches the eye.
THING_HALF_PX = 40
# Corners that the square must hold.
MIN_CORNERS = 10
# Share of these corners that must be as far away as the middle.
MIN_ON_THING = 0.6
# Relative difference of distance up to which a corner counts as that far away.
SAME_DEPTH = 0.05


def sample_pairs(scan: Scan, gravity_in_scan: Array, count: int, seed: int = 11) -> list[AnchorPair]:
    """Return pairs of frames 0.3 to 4 m apart whose axes differ by less than 45 degrees, with a POI that both see.

    The plan is the ground plane of the scan, down being `gravity_in_scan` (3,). Raises `InvalidInputError` when the
    scan has too few such pairs.
    """
    rng = np.random.default_rng(seed)
    upright = rotation_between(gravity_in_scan, np.array([0.0, 0.0, -1.0]))
    pairs: list[AnchorPair] = []
    for _ in range(TRIES_PER_PAIR * count):
        monitor, phone = (scan.frames[int(row)] for row in rng.integers(0, len(scan.frames), 2))
        views = PairOfViews.of(scan, monitor, phone, upright)
        pair = None if views is None else views.pair(_anywhere(rng, scan.camera), f"pair_{len(pairs):04d}")
        if pair is not None:
            pairs.append(pair)
        if len(pairs) == count:
            return pairs
    raise InvalidInputError(
        f"The scan has only {len(pairs)} pairs of frames that see one POI from 0.3 to 4 m apart."
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class PairOfViews:
    """Two frames that may play monitoring camera and phone: far enough apart, facing nearly the same way.

    `upright` (3, 3) turns the scan's frame so that z is up.
    """

    scan: Scan
    monitor: Frame
    phone: Frame
    upright: Array
    monitor_depth_m: NDArray[np.float32]
    phone_depth_m: NDArray[np.float32]

    @staticmethod
    def of(scan: Scan, monitor: Frame, phone: Frame, upright: Array) -> PairOfViews | None:
        """Return the two frames, None when they are not 0.3 to 4 m apart or look more than 45 degrees apart."""
        one, other = monitor.scan_from_camera, phone.scan_from_camera
        baseline = float(np.linalg.norm(one.translation - other.translation))
        alike = one.rotation[:, 2] @ other.rotation[:, 2] >= MIN_AXES_COSINE
        if not (MIN_BASELINE_M < baseline < MAX_BASELINE_M and alike):
            return None
        return PairOfViews(
            scan=scan,
            monitor=monitor,
            phone=phone,
            upright=upright,
            monitor_depth_m=scan.depth_m(monitor),
            phone_depth_m=scan.depth_m(phone),
        )

    def pair(self, middle: tuple[int, int], name: str, half_px: int = REGION_HALF_PX) -> AnchorPair | None:
        """Return the pair with a POI whose region is a square around a pixel; None when the phone doesn't see it."""
        scan, camera = self.scan, self.scan.camera
        one, other = self.monitor.scan_from_camera, self.phone.scan_from_camera
        u, v = middle
        depth_m = float(self.monitor_depth_m[v, u])
        if not depth_m > 0:
            return None
        point = one.apply(camera.unproject(np.array([[u, v]]), np.array([depth_m])))[0]
        in_phone = other.inverse().apply(point[None])
        pixel = camera.project(in_phone)[0]
        low, high = np.array([MARGIN_PX, MARGIN_PX]), np.array([camera.width, camera.height]) - MARGIN_PX
        if not np.isfinite(pixel).all() or (pixel < low).any() or (pixel > high).any():
            return None
        seen = float(self.phone_depth_m[int(pixel[1]), int(pixel[0])])
        if abs(seen - in_phone[0, 2]) > MAX_DEPTH_DIFFERENCE * in_phone[0, 2]:
            return None
        places = {
            key: self.upright @ value
            for key, value in (("B", one.translation), ("C", point), ("A", other.translation))
        }
        h = half_px
        region = ((u - h, v - h), (u + h, v - h), (u + h, v + h), (u - h, v + h))
        distance_m = float(np.linalg.norm(point - one.translation))
        poi = Poi(
            id="poi",
            region_px=region,
            x=float(places["C"][0]),
            y=float(places["C"][1]),
            distance_m=distance_m,
        )
        b = places["B"]
        return AnchorPair(
            name=name,
            spec=AnchorSpec(
                venue_id="scan",
                floor_id="0",
                x=float(b[0]),
                y=float(b[1]),
                height_m=float(b[2]),
                heading_deg=None,
                camera=hint_of(camera),
                pois=(poi,),
            ),
            monitor=_loader(scan, self.monitor),
            phone=_loader(scan, self.phone),
            monitor_camera=camera,
            phone_camera=camera,
            phone_on_plan=places["A"][:2],
            gravity_in_phone=other.rotation.T @ self.upright.T @ np.array([0.0, 0.0, -1.0]),
            angle_deg=_angle_deg(one.translation - point, other.translation - point),
            distance_m=float(np.linalg.norm(other.translation - point)),
        )


def _anywhere(rng: np.random.Generator, camera: Camera) -> tuple[int, int]:
    """Return a pixel whose region is well inside the picture."""
    half = REGION_HALF_PX
    u = int(rng.integers(half + MARGIN_PX, camera.width - half - MARGIN_PX))
    return u, int(rng.integers(half + 20, camera.height - half - 20))


def pair_with_pois(
    rng: np.random.Generator,
    scan: Scan,
    gravity_in_scan: Array,
    monitor: Frame,
    phone: Frame,
    pois: int,
    anywhere: bool = False,
) -> AnchorPair | None:
    """Return two frames as monitoring camera and phone with up to `pois` POIs that both see, or None when they are no
    pair or see none.

    POIs are where the guide says that they belong: on things that catch the eye, beside each other
    (`middles_of_things`); or `anywhere`, over each other too.
    """
    views = PairOfViews.of(
        scan, monitor, phone, rotation_between(gravity_in_scan, np.array([0.0, 0.0, -1.0]))
    )
    if views is None:
        return None
    if anywhere:
        half, middles = REGION_HALF_PX, [_anywhere(rng, scan.camera) for _ in range(TRIES_PER_POI * pois)]
    else:
        half = THING_HALF_PX
        things = middles_of_things(to_gray(frame_rgb(scan, monitor)), views.monitor_depth_m, half)
        middles = [things[int(row)] for row in rng.permutation(len(things))]
    found: list[AnchorPair] = []
    for middle in middles:
        if anywhere or _is_beside(middle, found):
            pair = views.pair(middle, f"{monitor.name}, {phone.name}", half)
            found += [] if pair is None else [pair]
        if len(found) == pois:
            break
    if not found:
        return None
    named = tuple(replace(pair.spec.pois[0], id=f"poi{i}") for i, pair in enumerate(found))
    return replace(found[0], spec=replace(found[0].spec, pois=named))


def middles_of_things(
    gray: NDArray[np.uint8], depth_m: NDArray[np.float32], half_px: int
) -> list[tuple[int, int]]:
    """Return pixels u, v on things that catch the eye, by a picture (h, w) and its depths: corners with many others
    within `half_px`, most of them as far away, give or take 5 %, so that a region drawn there shows the thing."""
    height, width = gray.shape
    corners = cv2.goodFeaturesToTrack(gray, 800, 0.01, 5)
    if corners is None:
        return []
    spots = corners.reshape(-1, 2).round().astype(int)
    depths = depth_m[spots[:, 1], spots[:, 0]]
    border = half_px + MARGIN_PX
    found = []
    for (u, v), depth in zip(spots.tolist(), depths, strict=True):
        near = (np.abs(spots - [u, v]) < half_px).all(axis=1)
        is_inside = border < u < width - border and border < v < height - border
        if depth > 0 and is_inside and near.sum() >= MIN_CORNERS:
            on_it = np.abs(depths[near] / depth - 1.0) < SAME_DEPTH
            if on_it.mean() >= MIN_ON_THING:
                found.append((u, v))
    return found


def _is_beside(spot: tuple[int, int], found: list[AnchorPair]) -> bool:
    """Whether a spot is outside the regions of POIs that were found."""
    middles = [np.mean(pair.spec.pois[0].region_px, axis=0) for pair in found]
    return all(np.abs(middle - spot).max() >= THING_HALF_PX for middle in middles)


def _loader(scan: Scan, frame: Frame) -> Callable[[], Rgb]:
    return lambda: frame_rgb(scan, frame)


def _angle_deg(a: Array, b: Array) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)), -1.0, 1.0))))


def posed_pictures(scan: Scan, low_deg: float, high_deg: float, count: int, seed: int) -> list[PosedPictures]:
    """Return up to `count` pairs of frames, and their true poses, by the angle between their optical axes."""
    rng = np.random.default_rng(seed)
    found: list[PosedPictures] = []
    for _ in range(TRIES_PER_PAIR * count):
        if len(found) == count:
            break
        one, other = (scan.frames[int(row)] for row in rng.integers(0, len(scan.frames), 2))
        apart = _angle_deg(one.scan_from_camera.rotation[:, 2], other.scan_from_camera.rotation[:, 2])
        baseline = float(
            np.linalg.norm(one.scan_from_camera.translation - other.scan_from_camera.translation)
        )
        if not (low_deg <= apart < high_deg and MIN_BASELINE_M < baseline < MAX_BASELINE_M):
            continue
        first, second = to_gray(frame_rgb(scan, one)), to_gray(frame_rgb(scan, other))
        pose = other.scan_from_camera.inverse() @ one.scan_from_camera
        found.append(PosedPictures(first, second, scan.camera, scan.camera, pose))
    return found
