"""A reconstruction found anew from poses that are nearly right: points of all matches, pictures beside them, a bundle
adjustment."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.engine.mapping.structure.floor.held import adjust_with_floor
from app.engine.mapping.structure.floor.levels import Floor, find_floor, is_better
from app.engine.mapping.structure.matches import MatchedPictures
from app.engine.mapping.structure.reconstruction import (
    Reconstruction,
    mapping_options,
    part_of,
    start_camera,
    write_database,
)
from app.engine.progress import Progress
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.limits import limit

STAGE = "adjust_structure"
Down = tuple[float, float, float]
REPORT_EVERY_PICTURES = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class RejoinOptions:
    """How points are made once the camera is calibrated."""

    min_angle_deg: float = limit(
        0.5,
        "Least angle between the rays to a point.",
        chosen="By hand: where the camera only turns, steps of 3 cm between pictures show points 3 m away at half a "
        "degree; each one's depth is known to some percent, and hundreds of them carry the scale around the turn.",
    )
    rounds: int = limit(
        2,
        "Bundle adjustments at the end, each after points that don't fit are left out and others added.",
        chosen="By hand: half a minute each of a video of four minutes.",
    )
    floor_rounds: int = limit(
        3,
        "Bundle adjustments after those, with the points of the floor on its level.",
        chosen="By hand, on a bent path of `roomfix evaluate-video`: 14.3 cm off, then 8.1, 4.6 and 4.6.",
    )
    floor_stretches: int = limit(
        3,
        "Stretches of a path that show the floor, at least.",
        chosen="By hand: fewer can't bend against each other.",
    )
    min_cost_change_ratio: float = limit(
        1e-6,
        "An adjustment stops where a step changes the sum of squared errors by a smaller ratio.",
        chosen="By hand: the errors don't fall by a thousandth of a pixel any more.",
    )
    report_every_s: float = limit(5.0, "Time between two reports of an adjustment.", chosen="By hand.")


OPTIONS = RejoinOptions()


def rejoined(
    matched: MatchedPictures,
    poses: Mapping[int, Pose],
    camera: Camera,
    *,
    is_calibrated: bool,
    scratch: Path | None,
    progress: Progress,
    down: Down | None = None,
) -> Reconstruction | None:
    """Return the part with points of all matches and `poses` (by picture) adjusted to them; None where too few hold.

    Pictures without a pose are registered where they see enough of the points. `camera` is what the adjustment starts
    from, and `is_calibrated` which of its numbers it keeps, as in `reconstruct`. Where `down` is known and the pictures
    show a floor, its points are held on one level.
    """
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    options = _options(pycolmap, camera, is_calibrated)
    with tempfile.TemporaryDirectory(prefix="structure-", dir=scratch) as folder:
        path = Path(folder) / "matches.db"
        write_database(pycolmap, path, matched, start_camera(pycolmap, camera, is_calibrated))
        with pycolmap.Database.open(path) as database:
            cache = pycolmap.DatabaseCache.create(database, pycolmap.DatabaseCacheOptions())
    model = pycolmap.Reconstruction()
    model.load(cache)
    _register(pycolmap, model, poses)
    mapper = pycolmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(model)
    _triangulate(mapper, options, model, progress)
    adjustment = _Adjustment(colmap=pycolmap, mapper=mapper, options=options, progress=progress)
    adjustment.run(1)
    _grow(mapper, _options(pycolmap, camera, is_calibrated=True), progress)
    adjustment.run(OPTIONS.rounds)
    free = part_of(model, camera)
    held = free if free is None or down is None else _held_on_floor(adjustment, free, camera, down)
    mapper.end_reconstruction(False)
    return held


def _held_on_floor(
    adjustment: _Adjustment, free: Reconstruction, camera: Camera, down: Down
) -> Reconstruction | None:
    """Return the part with the points of its floor on one level, and the free part where that makes it no better.

    Held from the beginning, before the pictures agree with each other, a path may be flat and bend elsewhere.
    """
    first = floor = find_floor(free, down)
    found = free
    for _ in range(OPTIONS.floor_rounds):
        if floor is None or len(floor.above) < OPTIONS.floor_stretches:
            return free
        adjustment.run(1, floor)
        held = part_of(adjustment.mapper.reconstruction, camera)
        if held is None:
            return free
        found, floor = held, find_floor(held, down)
    return found if first is not None and is_better(floor, first) else free


def _options(colmap: Any, camera: Camera, is_calibrated: bool) -> Any:
    options = mapping_options(colmap, camera, is_calibrated)
    options.triangulation.min_angle = OPTIONS.min_angle_deg
    options.mapper.filter_min_tri_angle = OPTIONS.min_angle_deg
    options.ba_global_function_tolerance = OPTIONS.min_cost_change_ratio
    return options


def _register(colmap: Any, model: Any, poses: Mapping[int, Pose]) -> None:
    for image in model.images.values():
        pose = poses.get(int(image.name))
        if pose is not None:
            image.frame.rig_from_world = colmap.Rigid3d(pose.inverse().matrix[:3])
            model.register_frame(image.frame_id)


def _triangulate(mapper: Any, options: Any, model: Any, progress: Progress) -> None:
    images = sorted(model.reg_image_ids())
    for number, image_id in enumerate(images):
        if number % REPORT_EVERY_PICTURES == 0:
            progress.report(STAGE, number, len(images))
        mapper.triangulate_image(options.get_triangulation(), image_id)
    mapper.complete_and_merge_tracks(options.get_triangulation())


@dataclass(frozen=True, slots=True, kw_only=True)
class _Adjustment:
    """Adjusts poses, points and camera as pycolmap's `iterative_global_refinement` does in one step.

    That one holds Python's lock for minutes, so that nothing could be reported.
    """

    colmap: Any
    mapper: Any
    options: Any
    progress: Progress

    def run(self, rounds: int, floor: Floor | None = None) -> None:
        """Adjust so many times, where a floor is given with its points on its level."""
        triangulation = self.options.get_triangulation()
        for _ in range(rounds):
            # A floor names its points by their rows, which new and merged points would change.
            if floor is None:
                self.mapper.complete_and_merge_tracks(triangulation)
                self.mapper.retriangulate(triangulation)
                self.mapper.observation_manager.filter_observations_with_negative_depth()
            self._solve(floor)
            self.mapper.reconstruction.normalize()
            self.mapper.complete_and_merge_tracks(triangulation)
            self.mapper.filter_points(self.options.get_mapper())
            self.mapper.filter_frames(self.options.get_mapper())

    def _solve(self, floor: Floor | None) -> None:
        model, options = self.mapper.reconstruction, self.options.get_global_bundle_adjustment()
        if floor is None:
            self._report(lambda: self.colmap.bundle_adjustment(model, options))
        else:
            images = len(model.reg_image_ids())
            adjust_with_floor(
                self.colmap, model, options, floor, lambda: self.progress.report(STAGE, images, images)
            )

    def _report(self, solve: Callable[[], Any]) -> None:
        """Solve in a thread, and report meanwhile; what `progress` raises is raised when the adjustment has ended."""
        images = len(self.mapper.reconstruction.reg_image_ids())
        raised: BaseException | None = None
        with ThreadPoolExecutor(1) as one:
            solved = one.submit(solve)
            while raised is None:
                try:
                    self.progress.report(STAGE, images, images)
                except BaseException as error:
                    raised = error
                if wait([solved], OPTIONS.report_every_s).done:
                    break
        solved.result()
        if raised is not None:
            raise raised


def _grow(mapper: Any, options: Any, progress: Progress) -> int:
    """Register further pictures, the best first, with their points; return how many."""
    grown = 0
    while _register_next(mapper, options):
        grown += 1
        progress.report(STAGE, mapper.num_total_reg_images(), mapper.num_total_reg_images())
    return grown


def _register_next(mapper: Any, options: Any) -> bool:
    for image_id in mapper.find_next_images(options.get_mapper(), False):
        if mapper.register_next_image(options.get_mapper(), image_id):
            mapper.triangulate_image(options.get_triangulation(), image_id)
            mapper.iterative_local_refinement(
                options.ba_local_max_refinements,
                options.ba_local_max_refinement_change,
                options.get_mapper(),
                options.get_local_bundle_adjustment(),
                options.get_triangulation(),
                image_id,
            )
            return True
    return False
