"""Pairs of frames of a recorded scan as monitoring camera and phone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidInputError
from app.evaluation.anchor_features import PosedPictures
from app.evaluation.anchors import AnchorPair
from app.geometry.se3 import rotation_between
from app.importers.frames import Frame, Scan
from app.services.frame_images import frame_rgb
from app.storage.anchors import AnchorSpec, Poi
from app.vision.images import Rgb, to_gray

Array = NDArray[np.float64]

MIN_BASELINE_M, MAX_BASELINE_M = 0.3, 4.0
MIN_AXES_COSINE = float(np.cos(np.radians(45.0)))
REGION_HALF_PX = 60
MAX_DEPTH_DIFFERENCE = 0.1
MARGIN_PX = 40
TRIES_PER_PAIR, TRIES_PER_POI = 200, 10


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
        pair = _pair(rng, scan, upright, monitor, phone, f"pair_{len(pairs):04d}")
        if pair is not None:
            pairs.append(pair)
        if len(pairs) == count:
            return pairs
    raise InvalidInputError(
        f"The scan has only {len(pairs)} pairs of frames that see one POI from 0.3 to 4 m apart."
    )


def _pair(
    rng: np.random.Generator, scan: Scan, upright: Array, monitor: Frame, phone: Frame, name: str
) -> AnchorPair | None:
    camera = scan.camera
    one, other = monitor.scan_from_camera, phone.scan_from_camera
    baseline = float(np.linalg.norm(one.translation - other.translation))
    if (
        not MIN_BASELINE_M < baseline < MAX_BASELINE_M
        or one.rotation[:, 2] @ other.rotation[:, 2] < MIN_AXES_COSINE
    ):
        return None
    half = REGION_HALF_PX
    u = int(rng.integers(half + MARGIN_PX, camera.width - half - MARGIN_PX))
    v = int(rng.integers(half + 20, camera.height - half - 20))
    depth_m = float(scan.depth_m(monitor)[v, u])
    if not depth_m > 0:
        return None
    point = one.apply(camera.unproject(np.array([[u, v]]), np.array([depth_m])))[0]
    in_phone = other.inverse().apply(point[None])
    pixel = camera.project(in_phone)[0]
    low, high = np.array([MARGIN_PX, MARGIN_PX]), np.array([camera.width, camera.height]) - MARGIN_PX
    if not np.isfinite(pixel).all() or (pixel < low).any() or (pixel > high).any():
        return None
    seen = float(scan.depth_m(phone)[int(pixel[1]), int(pixel[0])])
    if abs(seen - in_phone[0, 2]) > MAX_DEPTH_DIFFERENCE * in_phone[0, 2]:
        return None
    places = {
        key: upright @ value
        for key, value in (("B", one.translation), ("C", point), ("A", other.translation))
    }
    region = ((u - half, v - half), (u + half, v - half), (u + half, v + half), (u - half, v + half))
    distance_m = float(np.linalg.norm(point - one.translation))
    poi = Poi("poi", region, float(places["C"][0]), float(places["C"][1]), distance_m)
    b = places["B"]
    spec = AnchorSpec("scan", "0", float(b[0]), float(b[1]), float(b[2]), None, camera, (poi,))
    return AnchorPair(
        name,
        spec,
        _loader(scan, monitor),
        _loader(scan, phone),
        camera,
        camera,
        places["A"][:2],
        other.rotation.T @ upright.T @ np.array([0.0, 0.0, -1.0]),
        _angle_deg(one.translation - point, other.translation - point),
        float(np.linalg.norm(other.translation - point)),
    )


def pair_with_pois(
    rng: np.random.Generator, scan: Scan, gravity_in_scan: Array, monitor: Frame, phone: Frame, pois: int
) -> AnchorPair | None:
    """Return two frames as monitoring camera and phone with up to `pois` POIs that both see, or None when they are not
    0.3 to 4 m apart, look more than 45 degrees apart, or see none."""
    upright = rotation_between(gravity_in_scan, np.array([0.0, 0.0, -1.0]))
    found: list[AnchorPair] = []
    for _ in range(TRIES_PER_POI * pois):
        pair = _pair(rng, scan, upright, monitor, phone, f"{monitor.name}, {phone.name}")
        if pair is not None:
            found.append(pair)
        if len(found) == pois:
            break
    if not found:
        return None
    named = tuple(replace(pair.spec.pois[0], id=f"poi{i}") for i, pair in enumerate(found))
    return replace(found[0], spec=replace(found[0].spec, pois=named))


def _loader(scan: Scan, frame: Frame) -> Callable[[], Rgb]:
    return lambda: frame_rgb(scan, frame)


def _angle_deg(a: Array, b: Array) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)), -1.0, 1.0))))


def posed_pictures(scan: Scan, low_deg: float, high_deg: float, count: int, seed: int) -> list[PosedPictures]:
    """Return up to `count` pairs of frames whose optical axes are so many degrees apart, with their true poses."""
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
