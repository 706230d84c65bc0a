"""Incremental structure from motion by pycolmap: camera poses, points and the camera from verified matches.

Source: Schoenberger and Frahm, "Structure-from-Motion Revisited", 2016. pycolmap's pixels have the centre of the first
one at (0.5, 0.5).
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.matches import MatchedPictures, Pair
from app.engine.progress import Progress
from app.errors import InvalidCameraError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.limits import limit

Array = NDArray[np.float64]
HALF_PX = 0.5
STAGE = "reconstruct"
NOT_INSTALLED = (
    "Poses are estimated from pictures by pycolmap, which is not installed: pip install 'roomfix[sfm]'."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReconstructionOptions:
    """What a reconstruction must reach."""

    min_frames: int = limit(
        8, "Frames of a part that counts as a reconstruction.", chosen="By hand: fewer tie nothing together."
    )
    min_focal_ratio: float = limit(
        0.35,
        "Least focal length over the longer side that calibration may find.",
        chosen="By hand: 110 degrees of view; a wider lens needs its own model, given as camera.",
    )
    max_focal_ratio: float = limit(
        4.0,
        "Largest focal length over the longer side that calibration may find.",
        chosen="By hand: 14 degrees of view; phones' telephoto lenses are wider.",
    )
    max_distortion: float = limit(
        0.5,
        "Largest absolute radial coefficient that calibration may find.",
        chosen="By hand: past phones' lenses.",
    )
    compared_points: int = limit(
        2000, "Points whose rays are compared.", chosen="By hand: tells the median within some percent."
    )
    threads: int = limit(
        1,
        "Threads of the adjustment.",
        chosen="By hand: it repeats itself exactly with one, and others work too.",
    )
    same_focal_ratio: float = limit(
        0.01,
        "Relative difference of fx and fy below which a given pinhole gets a radial coefficient.",
        chosen="By hand: square pixels up to rounding.",
    )


OPTIONS = ReconstructionOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class Reconstruction:
    """A connected part: its camera, `scan_from_camera` by picture, and points (n, 3) in a unit of their own.

    `observations` (m, 3) are rows of pictures, of the picture's features, and of points. `error_px` is the mean
    reprojection error.
    """

    camera: Camera
    poses: dict[int, Pose]
    points: Array
    observations: NDArray[np.intp]
    error_px: float


def median_depth(part: Reconstruction) -> float:
    """Return the median depth of the features in their pictures."""
    pictures, _, points = part.observations.T
    depths = [
        part.poses[row].inverse().apply(part.points[points[pictures == row]])[:, 2] for row in part.poses
    ]
    return float(np.median(np.concatenate(depths)))


def median_angle_deg(part: Reconstruction) -> float:
    """Return the median, over some of the points, of the largest angle between two of its rays."""
    order = np.argsort(part.observations[:, 2], kind="stable")
    pictures, _, points = part.observations[order].T
    found, starts = np.unique(points, return_index=True)
    ends = np.append(starts[1:], len(points))
    every = max(1, len(found) // OPTIONS.compared_points)
    cosines = []
    for point, start, end in zip(found[::every], starts[::every], ends[::every], strict=True):
        rays = np.array([part.poses[row].translation for row in pictures[start:end]]) - part.points[point]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        cosines.append((rays @ rays.T).min())
    return float(np.degrees(np.arccos(np.clip(np.median(cosines), -1.0, 1.0))))


def check_installed() -> None:
    """Raise `InvalidScanError` where pycolmap is not installed."""
    if find_spec("pycolmap") is None:
        raise InvalidScanError(NOT_INSTALLED)


def reconstruct(
    matched: MatchedPictures, camera: Camera, *, is_calibrated: bool, scratch: Path | None, progress: Progress
) -> list[Reconstruction]:
    """Return the connected parts, the largest first; none where nothing could be reconstructed.

    Calibration starts from `camera`. With `is_calibrated` its focal length and principal point are kept, as are all
    numbers of a camera with a lens model; a pinhole gets a radial coefficient. Repeats itself. Raises what `progress`
    raises.
    """
    check_installed()
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    total = len(matched.features)
    progress.report(STAGE, 0, total)
    with tempfile.TemporaryDirectory(prefix="structure-", dir=scratch) as folder:
        database = Path(folder) / "matches.db"
        write_database(pycolmap, database, matched, start_camera(pycolmap, camera, is_calibrated))
        models = _run(
            pycolmap,
            database,
            Path(folder),
            mapping_options(pycolmap, camera, is_calibrated),
            total,
            progress,
        )
        parts = [part_of(model, camera) for model in models]
    whole = [part for part in parts if part is not None and len(part.poses) >= OPTIONS.min_frames]
    return sorted(whole, key=lambda part: -len(part.poses))


def start_camera(colmap: Any, camera: Camera, is_calibrated: bool) -> Any:
    """Return the camera that the adjustment starts from, in terms of pycolmap (`colmap` is the module)."""
    fx, fy, cx, cy, *lens = camera.params
    centre = cx + HALF_PX, cy + HALF_PX
    if _gets_radial(camera, is_calibrated):
        model, params = "SIMPLE_RADIAL", [camera.focal_px, *centre, *(lens[:1] or [0.0])]
    else:
        model, params = camera.model, [fx, fy, *centre, *lens]
    made = colmap.Camera(model=model, width=camera.width, height=camera.height, params=params)
    made.has_prior_focal_length = is_calibrated
    return made


def _gets_radial(camera: Camera, is_calibrated: bool) -> bool:
    fx, fy = camera.params[:2]
    plain = camera.model == "PINHOLE" and abs(fx / fy - 1) < OPTIONS.same_focal_ratio
    return plain or not is_calibrated


def write_database(
    colmap: Any,
    path: Path,
    matched: MatchedPictures,
    camera: Any,
    motions: Mapping[Pair, Pose] | None = None,
) -> None:
    """Write a database of keypoints and verified matches; a picture's name is its row.

    `motions` are the `b_from_a` of all pairs where they are known.
    """
    with colmap.Database.open(path) as database:
        camera.camera_id = database.write_camera(camera)
        rig = colmap.Rig()
        rig.add_ref_sensor(camera.sensor_id)
        rig_id = database.write_rig(rig)
        ids = []
        for row, features in enumerate(matched.features):
            image = colmap.Image(name=str(row), camera_id=camera.camera_id)
            image.image_id = database.write_image(image)
            frame = colmap.Frame()
            frame.rig_id = rig_id
            frame.add_data_id(image.data_id)
            database.write_frame(frame)
            database.write_keypoints(image.image_id, (features.keypoints_px + HALF_PX).astype(np.float32))
            ids.append(image.image_id)
        for (i, j), rows in matched.matches.items():
            pairs = rows.astype(np.uint32)
            database.write_matches(ids[i], ids[j], pairs)
            geometry = colmap.TwoViewGeometry()
            geometry.config = int(colmap.TwoViewGeometryConfiguration.UNCALIBRATED)
            geometry.inlier_matches = pairs
            if motions is not None:
                b_from_a = motions[i, j]
                geometry.config = int(colmap.TwoViewGeometryConfiguration.CALIBRATED)
                geometry.cam2_from_cam1 = colmap.Rigid3d(b_from_a.matrix[:3])
            database.write_two_view_geometry(ids[i], ids[j], geometry)


def mapping_options(colmap: Any, camera: Camera, is_calibrated: bool) -> Any:
    """Return pycolmap's options: one thread, a fixed seed, and which numbers of the camera are adjusted."""
    options = colmap.IncrementalPipelineOptions()
    options.random_seed = 0
    options.num_threads = OPTIONS.threads
    options.extract_colors = False
    options.min_model_size = OPTIONS.min_frames
    options.ba_refine_focal_length = not is_calibrated
    options.ba_refine_extra_params = _gets_radial(camera, is_calibrated)
    options.mapper.abs_pose_refine_focal_length = not is_calibrated
    options.mapper.abs_pose_refine_extra_params = options.ba_refine_extra_params
    if not is_calibrated:
        options.min_focal_length_ratio = OPTIONS.min_focal_ratio
        options.max_focal_length_ratio = OPTIONS.max_focal_ratio
        options.max_extra_param = OPTIONS.max_distortion
    return options


def _run(
    colmap: Any, database: Path, folder: Path, options: Any, total: int, progress: Progress
) -> list[Any]:
    """Return pycolmap's reconstructions; what `progress` raises stops the work and is raised when it has stopped."""
    token = colmap.CancellationToken()
    raised: list[BaseException] = []
    count = 0

    def guarded(step: Callable[[], None]) -> Callable[[], None]:
        def call() -> None:
            try:
                step()
            except BaseException as error:
                raised.append(error)
                token.cancel()

        return call

    def begin() -> None:
        nonlocal count
        count = 2
        progress.report(STAGE, count, total)

    def advance() -> None:
        nonlocal count
        count = min(count + 1, total)
        progress.report(STAGE, count, total)

    output = folder / "models"
    output.mkdir()
    try:
        models = colmap.incremental_mapping(
            database,
            folder,
            output,
            options=options,
            initial_image_pair_callback=guarded(begin),
            next_image_callback=guarded(advance),
            cancellation_token=token,
        )
    except InterruptedError:
        if not raised:
            raise
    if raised:
        raise raised[0]
    return list(models.values())


def part_of(model: Any, started_from: Camera) -> Reconstruction | None:
    """Return pycolmap's reconstruction in our terms, None where it found a camera that no lens has."""
    images = {int(image.name): image for image in model.images.values() if image.has_pose}
    camera = camera_of(next(iter(model.cameras.values())), started_from)
    if camera is None:
        return None
    rows = {point_id: row for row, point_id in enumerate(model.points3D)}
    observations = [
        (row, number, rows[point.point3D_id])
        for row, image in images.items()
        for number, point in enumerate(image.points2D)
        if point.has_point3D()
    ]
    return Reconstruction(
        camera=camera,
        poses={row: pose_of(image) for row, image in sorted(images.items())},
        points=np.array([point.xyz for point in model.points3D.values()], dtype=np.float64).reshape(-1, 3),
        observations=np.array(observations, dtype=np.intp).reshape(-1, 3),
        error_px=float(model.compute_mean_reprojection_error()),
    )


def pose_of(image: Any) -> Pose:
    """Return `scan_from_camera` of a picture of pycolmap's."""
    matrix = np.vstack([np.asarray(image.cam_from_world().matrix(), dtype=np.float64), [0, 0, 0, 1]])
    return Pose.from_matrix(matrix).inverse()


def camera_of(found: Any, started_from: Camera) -> Camera | None:
    """Return a camera of pycolmap's in our terms, None for one that no lens has."""
    if found.model.name != "SIMPLE_RADIAL":
        return started_from
    focal, cx, cy, k = (float(value) for value in found.params)
    params = (focal, focal, cx - HALF_PX, cy - HALF_PX, k, 0.0, 0.0, 0.0)
    try:
        return Camera("OPENCV", found.width, found.height, params)
    except InvalidCameraError:
        return None
