"""Poses of all pictures of a stretch at once, by the motions between them: turns first, then positions and points.

Source: Pan, Barath, Pollefeys and Schoenberger, "Global Structure-from-Motion Revisited" (GLOMAP), 2024, by pycolmap.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.engine.mapping.structure.matches import MatchedPictures, Pair
from app.engine.mapping.structure.reconstruction import OPTIONS as RECONSTRUCTION
from app.engine.mapping.structure.reconstruction import (
    Reconstruction,
    part_of,
    start_camera,
    write_database,
)
from app.engine.mapping.structure.windows.motions import Motion
from app.geometry.camera import Camera
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionOptions:
    """Which points take part."""

    min_angle_deg: float = limit(
        0.3,
        "Least angle between the rays to a point.",
        chosen="By hand: less than when points are made anew, for the positions are not exact yet.",
    )


OPTIONS = PositionOptions()


def positioned(
    matched: MatchedPictures, motions: Mapping[Pair, Motion], camera: Camera, scratch: Path | None
) -> list[Reconstruction]:
    """Return the parts that the motions between pictures connect, the largest first, with poses that are nearly right.

    The scale may still slide along a part, by tens of percent: `rejoined` adjusts it.
    """
    import pycolmap

    rows = {pair: matched.matches[pair][motion.inliers] for pair, motion in motions.items()}
    with tempfile.TemporaryDirectory(prefix="structure-", dir=scratch) as folder:
        database, output = Path(folder) / "matches.db", Path(folder) / "models"
        output.mkdir()
        write_database(
            pycolmap,
            database,
            MatchedPictures(matched.features, rows),
            start_camera(pycolmap, camera, is_calibrated=True),
            {pair: motion.b_from_a for pair, motion in motions.items()},
        )
        pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
        models = pycolmap.global_mapping(database, folder, output, _options(pycolmap))
        parts = [part_of(model, camera) for model in models.values()]
    return sorted((part for part in parts if part is not None), key=lambda part: -len(part.poses))


def _options(colmap: Any) -> Any:
    options = colmap.GlobalPipelineOptions()
    options.num_threads = options.mapper.num_threads = RECONSTRUCTION.threads
    options.random_seed = options.mapper.random_seed = 0
    options.min_model_size = RECONSTRUCTION.min_frames
    options.decompose_relative_pose = False
    options.mapper.global_positioning.use_gpu = False
    options.mapper.min_tri_angle_deg = OPTIONS.min_angle_deg
    # What comes next does both with all matches.
    options.mapper.skip_bundle_adjustment = options.mapper.skip_retriangulation = True
    return options
