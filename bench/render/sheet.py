"""A printed sheet in a rendered picture: a rectangle with its own print, hidden by what is before it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.markers import DICTIONARY
from app.geometry.camera import Camera
from app.geometry.se3 import Pose

# The page of a marker: A4, upright.
PAGE_M = (0.21, 0.297)
PRINT_PX_PER_M = 4000
# Rendered pixels are averaged over this number of samples each way.
SAMPLES = 4
# The sheet hides what is less than this before it: the surface that it is put on.
BEFORE_M = 0.05
PAPER = 235
INK = 25


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkerSheet:
    """A page with an ArUco marker, whose black square has a side of `side_m`; `world_from_sheet` has its origin in the
    middle of the page, x to the right and y down on the print."""

    number: int
    side_m: float
    world_from_sheet: Pose


def with_sheet(
    rgb: NDArray[np.uint8],
    depth_m: NDArray[np.float32],
    camera: Camera,
    world_from_camera: Pose,
    sheet: MarkerSheet,
) -> NDArray[np.uint8]:
    """Return a rendered picture (h, w, 3) with the sheet in it, where its exact depth (h, w) shows nothing before it.

    The camera is a pinhole.
    """
    width, height = PAGE_M
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [width / 2, height / 2, 0]
    camera_from_sheet = world_from_camera.inverse() @ sheet.world_from_sheet
    in_camera = camera_from_sheet.apply(corners)
    faces = camera_from_sheet.rotation[:, 2] @ in_camera.mean(axis=0) > 0
    if in_camera[:, 2].min() < 0.1 or not faces:
        return rgb
    page = _page(sheet.number, sheet.side_m)
    on_page = np.array([[0, 0], [page.shape[1], 0], page.shape[::-1], [0, page.shape[0]]]) - 0.5
    on_picture = (camera.project(in_camera) + 0.5) * SAMPLES - 0.5
    if not _touches(on_picture / SAMPLES, camera):
        return rgb
    warp = cv2.getPerspectiveTransform(on_page.astype(np.float32), on_picture.astype(np.float32))
    size = camera.width * SAMPLES, camera.height * SAMPLES
    small = camera.width, camera.height
    ink = cv2.resize(cv2.warpPerspective(page, warp, size), small, interpolation=cv2.INTER_AREA)
    cover = cv2.resize(
        cv2.warpPerspective(np.full_like(page, 255), warp, size), small, interpolation=cv2.INTER_AREA
    )
    share = cover.astype(np.float32)[..., None] / 255
    share[(depth_m > 0) & (depth_m < in_camera[:, 2].min() - BEFORE_M)] = 0
    shown = share * np.maximum(ink.astype(np.float32)[..., None] / np.maximum(share, 1e-3), 0)
    return np.asarray(np.clip((1 - share) * rgb + shown + 0.5, 0, 255), dtype=np.uint8)


def _touches(pixels: NDArray[np.float64], camera: Camera) -> bool:
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    return bool((high > 0).all() and low[0] < camera.width and low[1] < camera.height)


@lru_cache(maxsize=2)
def _page(number: int, side_m: float) -> NDArray[np.uint8]:
    width, height = (round(length * PRINT_PX_PER_M) for length in PAGE_M)
    side = round(side_m * PRINT_PX_PER_M)
    page = np.full((height, width), PAPER, np.uint8)
    left, top = (width - side) // 2, (height - side) // 2
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARY)
    marker = cv2.aruco.generateImageMarker(dictionary, number, side)
    page[top : top + side, left : left + side] = np.where(marker > 0, PAPER, INK)
    return page
