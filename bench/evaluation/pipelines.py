"""The ways of localization that can be compared, by name."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.build_map import BuiltMap
from app.engine.mapping.options import BuildOptions
from app.engine.maps.open_map import OpenMap
from app.engine.maps.vision_models import VisionModels
from app.engine.query.localization import Localization
from app.engine.query.localizer import Localizer
from app.engine.query.settings import PAPER, LocalizerSettings
from app.engine.query.vdm.localizer import VdmLocalizer
from app.geometry.camera import Camera
from app.vision.images import Rgb
from bench.baselines.enough_matches import EnoughMatchesLocalizer
from bench.baselines.epipolar import EpipolarLocalizer
from bench.baselines.two_images import TwoImageLocalizer

Pipeline = Literal["default", "paper", "two-images", "vdm", "epipolar"]
PIPELINES: tuple[Pipeline, ...] = ("default", "paper", "two-images", "vdm", "epipolar")


class FrameLocalizer(Protocol):
    """What locates a frame in a map."""

    def localize(
        self, rgb: Rgb, camera: Camera | None, allowed: NDArray[np.int64] | None = None
    ) -> Localization:
        """Locate an RGB image (height, width, 3)."""
        ...


def open_pipeline(
    name: Pipeline, built: BuiltMap, models: VisionModels, settings: LocalizerSettings | None = None
) -> FrameLocalizer:
    """Return the localizer of that name on a map; `settings` are for `default` and `paper`."""
    opened = OpenMap.of(built.artifact, built.index, models)
    if name == "vdm":
        return VdmLocalizer(opened)
    if name == "epipolar":
        return EpipolarLocalizer(opened)
    if name == "two-images":
        return TwoImageLocalizer(opened)
    if name == "paper":
        return EnoughMatchesLocalizer(Localizer(opened, settings or PAPER))
    return Localizer(opened, settings or LocalizerSettings())


def options_for(name: Pipeline, options: BuildOptions) -> BuildOptions:
    """Return the options of the map that a pipeline needs: paper A has ORB and each keyframe's depth as it is, and so
    has its reference method, which leaves the depth unused."""
    theirs = name in ("paper", "two-images")
    return replace(options, features="orb", refine_depth=False) if theirs else options
