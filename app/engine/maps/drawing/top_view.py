"""A floor of a map from above: its points and the way of its keyframes, over the plan image if there is one."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.floors.floor import PlanImage
from app.engine.maps.drawing.points import DrawnPoints
from app.geometry.plan import pixels_from_plan
from app.limits import limit

KEYFRAME_RGB = (20, 90, 220)


@dataclass(frozen=True, slots=True, kw_only=True)
class TopViewOptions:
    """How a floor is drawn from above."""

    margin_m: float = limit(
        1.0, "Free space around the points where there is no plan image.", chosen="By hand."
    )
    plan_opacity_ratio: float = limit(
        0.35, "How much of the plan image shows under the points.", chosen="By hand: lines stay readable."
    )
    outlier_share: float = limit(
        0.002,
        "Share of the points at each side that doesn't count for the extent.",
        chosen="By hand: a few points behind mirrors and windows would make the rest small.",
    )


OPTIONS = TopViewOptions()


@dataclass(frozen=True, slots=True)
class Sheet:
    """An image to draw on (height, width, 3) in RGB, the metres of a pixel, and the pixel of plan (0, 0)."""

    rgb: NDArray[np.uint8]
    meters_per_pixel: float
    origin_px: tuple[float, float]

    def pixels(self, xy: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the pixels (n, 2) of plan points (n, 2) that are on the sheet."""
        u, v = pixels_from_plan(xy[:, 0], xy[:, 1], self.meters_per_pixel, self.origin_px)
        found = np.round(np.stack([u, v], axis=-1)).astype(np.intp)
        height, width = self.rgb.shape[:2]
        return np.asarray(found[(found >= 0).all(axis=1) & (found < [width, height]).all(axis=1)])


def plan_sheet(image_rgb: NDArray[np.uint8], plan: PlanImage, width_px: int) -> Sheet:
    """Return a sheet with a plan image, paler, `width_px` wide."""
    scale = width_px / image_rgb.shape[1]
    size = (width_px, max(1, round(image_rgb.shape[0] * scale)))
    resized = cv2.resize(image_rgb, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    pale = 255 - (255 - resized.astype(np.float32)) * OPTIONS.plan_opacity_ratio
    u, v = (scale * (value + 0.5) - 0.5 for value in plan.origin_px)
    return Sheet(pale.astype(np.uint8), plan.meters_per_pixel / scale, (u, v))


def blank_sheet(xy: NDArray[np.float64], width_px: int) -> Sheet:
    """Return a white sheet, its longer side `width_px`, that plan points (n, 2) fit on."""
    points = xy if len(xy) else np.zeros((1, 2))
    share = OPTIONS.outlier_share
    low, high = np.quantile(points, share, axis=0), np.quantile(points, 1 - share, axis=0)
    low, high = low - OPTIONS.margin_m, high + OPTIONS.margin_m
    meters_per_pixel = float((high - low).max()) / width_px
    width, height = np.maximum(np.ceil((high - low) / meters_per_pixel), 1).astype(int)
    origin = (-low[0] / meters_per_pixel, high[1] / meters_per_pixel)
    return Sheet(np.full((height, width, 3), 255, np.uint8), meters_per_pixel, origin)


def top_view_png(
    sheet: Sheet, points: DrawnPoints, xy: NDArray[np.float64], keyframes_xy: NDArray[np.float64]
) -> bytes:
    """Return the PNG of a sheet with points (n, 2) in their colours, low ones first, and keyframes (k, 2) as dots."""
    order = np.argsort(points.points_in_world[:, 2], kind="stable")
    height, width = sheet.rgb.shape[:2]
    u, v = pixels_from_plan(xy[order, 0], xy[order, 1], sheet.meters_per_pixel, sheet.origin_px)
    columns, rows = np.round(u).astype(np.intp), np.round(v).astype(np.intp)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    drawn = sheet.rgb.copy()
    drawn[rows[inside], columns[inside]] = points.rgb[order][inside]
    for column, row in sheet.pixels(keyframes_xy):
        cv2.circle(drawn, (int(column), int(row)), 2, KEYFRAME_RGB, -1, cv2.LINE_AA)
    ok, data = cv2.imencode(".png", cv2.cvtColor(drawn, cv2.COLOR_RGB2BGR))
    if not ok:
        raise RuntimeError("OpenCV could not write a PNG.")
    return data.tobytes()
