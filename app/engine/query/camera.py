"""What is known of the camera of a query, and what its matches with a map say about focal length and lens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.maps.artifact import MapMetadata
from app.engine.query.matches import Matches
from app.errors import DegenerateGeometryError, InvalidCameraError
from app.geometry.camera import Camera
from app.geometry.focal import ApproximateCamera, focal_sigma_of, refine_camera
from app.geometry.lens import Focal, Lens, has_focal_of, refine_lens
from app.geometry.pnp import PnpEstimate
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class LensFitOptions:
    """When the lens of a query is fitted."""

    min_features: int = limit(
        30,
        "Fewest inliers that a lens is fitted to: fewer could be explained by a wrong pose and a lens"
        " that makes it fit.",
        chosen="roomfix evaluate-phones; docs/evaluation.md.",
    )


OPTIONS = LensFitOptions()


def lens_of_query(metadata: MapMetadata, known: Camera | ApproximateCamera | None) -> Lens | None:
    """Return the lens of a query's camera as far as it is known beforehand; None where its distortion is stated.

    A pinhole with the very focal lengths of a scan is the scan's camera, and its lens the one that the scan showed.
    """
    if not isinstance(known, Camera):
        return Lens()
    if known.model != "PINHOLE":
        return None
    return next((lens for camera, lens in metadata.shown_lenses if has_focal_of(camera, known)), Lens())


def scanned_camera(metadata: MapMetadata, known: Camera) -> Camera:
    """Return a query's camera with its distortion stated, where it is a scan's camera and the scan showed it; a lens
    that the scan showed to be none is stated as none."""
    lens = lens_of_query(metadata, known)
    if lens is None or lens.is_guess:
        return known
    return Camera("OPENCV", known.width, known.height, (*known.params[:4], lens.coefficient, 0.0, 0.0, 0.0))


def fit_query_camera(
    inliers: Matches,
    estimate: PnpEstimate,
    camera: Camera,
    known: Camera | ApproximateCamera | None,
    lens: Lens | None,
) -> Camera | None:
    """Return the camera that a picture's inliers fit best with their pose, near a `camera` that they fit.

    A focal length that was searched for is fitted to more inliers than it was found with. None where it can't be.
    """
    pixels, points, pose = inliers.points_px, inliers.points_in_world, estimate.world_from_camera
    if not isinstance(known, Camera):
        near = known if known is not None and known.covers(camera) else None
        refined = refine_camera(pixels, points, camera, pose, near)
        if refined is None:
            return None
        camera = refined
    if lens is None or inliers.feature_count < OPTIONS.min_features:
        return camera
    sigma = focal_sigma_of(known, camera)
    focal_px = known.camera.focal_px if isinstance(known, ApproximateCamera) else camera.focal_px
    try:
        return refine_lens(pixels, points, camera, pose, lens, Focal(focal_px, sigma))
    except (InvalidCameraError, DegenerateGeometryError, np.linalg.LinAlgError):
        return camera if isinstance(known, Camera) else None
