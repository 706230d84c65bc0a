"""Another camera that explains the matches: another focal length, another principal point, or intrinsics turned."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from app.engine.mapping.examination.agreement import Rays, misfit
from app.engine.mapping.examination.evidence import Evidence
from app.errors import InvalidCameraError
from app.geometry.camera import Camera
from app.importers.conventions import PoseArrays
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraFitOptions:
    """How another camera is searched for."""

    max_focal_ratio: float = limit(
        2.6,
        "Focal lengths are searched up to this many times the stated one, and down to its inverse.",
        chosen="By hand: intrinsics of a picture of twice the size are a factor of 2.",
    )
    grid_steps: int = limit(31, "Focal lengths that are tried first.", chosen="By hand: 6 % apart.")
    searched_matches: int = limit(
        40,
        "Matches of a pair that a search looks at.",
        chosen="By hand: the search then takes a tenth of a second.",
    )


OPTIONS = CameraFitOptions()


def with_focal_ratio(camera: Camera, ratio: float) -> Camera:
    """Return the camera with its focal lengths multiplied; raises `InvalidCameraError` past what a lens can be."""
    fx, fy, *rest = camera.params
    return replace(camera, params=(fx * ratio, fy * ratio, *rest))


def fit_focal(evidence: Evidence, camera: Camera, poses: PoseArrays) -> Camera:
    """Return the camera with the focal length under which the matches fit the poses best."""
    few = evidence.thinned(OPTIONS.searched_matches)

    def cost(log_ratio: float) -> float:
        try:
            return misfit(few, Rays.of(few, with_focal_ratio(camera, float(np.exp(log_ratio)))), poses)
        except InvalidCameraError:
            return 1.0

    widest = np.log(OPTIONS.max_focal_ratio)
    grid = np.linspace(-widest, widest, OPTIONS.grid_steps)
    best = float(grid[int(np.argmin([cost(value) for value in grid]))])
    return with_focal_ratio(camera, float(np.exp(_refined(cost, best, float(grid[1] - grid[0])))))


def fit_principal_point(evidence: Evidence, camera: Camera, poses: PoseArrays) -> Camera:
    """Return the camera with the focal length and principal point under which the matches fit the poses best."""
    few = evidence.thinned(OPTIONS.searched_matches)
    fx, fy, cx, cy = camera.params[:4]
    size = float(max(camera.width, camera.height))

    def moved(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Camera:
        ratio = float(np.exp(values[0]))
        point = cx + size * float(values[1]), cy + size * float(values[2])
        return replace(camera, params=(fx * ratio, fy * ratio, *point, *camera.params[4:]))

    def cost(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
        try:
            return misfit(few, Rays.of(few, moved(values)), poses)
        except InvalidCameraError:
            return 1.0

    simplex = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    middle = (0.5 * (camera.width - 1) - cx) / size, (0.5 * (camera.height - 1) - cy) / size
    starts = [np.zeros(3), np.array([0.0, *middle])]
    found = [
        minimize(
            cost, start, method="Nelder-Mead", options={"initial_simplex": simplex + start, "maxfev": 120}
        )
        for start in starts
    ]
    best = min(found, key=lambda one: float(one.fun))
    try:
        return moved(best.x)
    except InvalidCameraError:
        return camera


def turned_intrinsics(camera: Camera) -> Iterator[Camera]:
    """Yield cameras whose numbers are those of the picture before it was turned by a quarter, one or the other way."""
    fx, fy, cx, cy = camera.params[:4]
    rest = camera.params[4:]
    for point in ((cy, camera.height - 1 - cx), (camera.width - 1 - cy, cx)):
        try:
            yield replace(camera, params=(fy, fx, *point, *rest))
        except InvalidCameraError:
            continue


def _refined(cost: Callable[[float], float], start: float, step: float) -> float:
    found = minimize_scalar(
        cost, bounds=(start - step, start + step), method="bounded", options={"maxiter": 20}
    )
    return float(found.x)
