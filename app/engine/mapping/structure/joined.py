"""A reconstruction found anew from poses that are nearly right: points of all matches, then a bundle adjustment."""

from __future__ import annotations

import tempfile
from pathlib import Path

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

STAGE = "adjust_structure"
REPORT_EVERY_PICTURES = 32


def rejoined(
    matched: MatchedPictures,
    poses: dict[int, Pose],
    camera: Camera,
    *,
    is_calibrated: bool,
    scratch: Path | None,
    progress: Progress,
) -> Reconstruction | None:
    """Return the part with points of all matches and `poses` (by picture) adjusted to them; None where too few hold.

    `camera` is what the adjustment starts from, and `is_calibrated` which of its numbers it keeps, as in `reconstruct`.
    """
    import pycolmap

    options = mapping_options(pycolmap, camera, is_calibrated)
    with tempfile.TemporaryDirectory(prefix="structure-", dir=scratch) as folder:
        path = Path(folder) / "matches.db"
        write_database(pycolmap, path, matched, start_camera(pycolmap, camera, is_calibrated))
        with pycolmap.Database.open(path) as database:
            cache = pycolmap.DatabaseCache.create(database, pycolmap.DatabaseCacheOptions())
    model = pycolmap.Reconstruction()
    model.load(cache)
    for image in model.images.values():
        pose = poses.get(int(image.name))
        if pose is None:
            continue
        camera_from_scan = pose.inverse()
        image.frame.rig_from_world = pycolmap.Rigid3d(camera_from_scan.matrix[:3])
        model.register_frame(image.frame_id)
    mapper = pycolmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(model)
    triangulation = options.get_triangulation()
    images = sorted(model.reg_image_ids())
    for number, image_id in enumerate(images):
        if number % REPORT_EVERY_PICTURES == 0:
            progress.report(STAGE, number, len(images))
        mapper.triangulate_image(triangulation, image_id)
    mapper.complete_and_merge_tracks(triangulation)
    for _ in range(options.ba_global_max_refinements):
        progress.report(STAGE, len(images), len(images))
        mapper.iterative_global_refinement(
            1,
            options.ba_global_max_refinement_change,
            options.get_mapper(),
            options.get_global_bundle_adjustment(),
            triangulation,
        )
    mapper.end_reconstruction(False)
    return part_of(model, camera)
