"""How a localizer localizes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from app.engine.query.verification import Limits
from app.geometry.camera import tangent_of_px
from app.limits import limit

MEASURED = "roomfix evaluate and benchmark on RedKitchen and the demonstration venue; docs/features.md."


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizerSettings:
    """How to localize. The defaults are the measured best; `PAPER` is paper A's pipeline.

    `keyframes` are matched for their looks, then up to `other_places` more that look alike but show other
    places, then `covisible` ones that see what the first pose sees; up to `look_alikes` for each of the best two
    may prove that the place is not unique. A frame that is not located gets a second attempt with `second_attempt`
    keyframes, turned ones too, and a third with the features of a faint image. `fit_lens` fits the lens of a camera
    whose distortion isn't stated; `check_intrinsics` compares a stated camera with the matches. Without
    `limits` those of the map's features hold.
    """

    keyframes: int = limit(10, "Most similar keyframes that a query is matched with.", chosen=MEASURED)
    other_places: int = limit(
        4, "Further keyframes, each of a place that the most similar ones don't show.", chosen=MEASURED
    )
    look_alikes: int = limit(
        6,
        "Keyframes of other places that look like one of the best two, which are matched too.",
        chosen=MEASURED,
    )
    covisible: int = limit(
        10, "Keyframes that see what the first pose sees, which are matched too.", chosen=MEASURED
    )
    second_attempt: int = limit(
        40,
        "Most similar keyframes that are matched when the first attempt fails; 0 for none.",
        chosen=MEASURED,
    )
    voted: int = limit(
        3,
        "Keyframes that share most single features with a frame, which come first in its second look.",
        chosen="By hand: half of those that the second look begins with.",
    )
    max_error_tangent: float = limit(
        tangent_of_px(6.0), "Inlier threshold: the reprojection error over the focal length.", chosen=MEASURED
    )
    rival_ratio: float = limit(
        0.1,
        "A rival with fewer inliers than this ratio of the best pose's is not examined.",
        chosen="By hand: far below max_rival_share, where a rival decides.",
    )
    min_rival_inliers: int = limit(
        8, "Fewest inliers of a rival.", chosen="By hand: twice what a pose needs."
    )
    rival_support_ratio: float = limit(
        0.0,
        "A rival with less support than this ratio of the best pose's is no rival.",
        chosen="By hand: by inliers, max_rival_share decides; a second look has its own ratio.",
    )
    convincing_inliers_factor: float = limit(
        5,
        "A first pose with this many times min_inliers, and convincing_coverage, needs no covisible keyframes.",
        chosen=MEASURED,
    )
    convincing_coverage: float = limit(0.4, "Coverage of a first pose that is convincing.", chosen=MEASURED)
    max_iterations: int = limit(5000, "RANSAC iterations of a pose.", chosen=MEASURED)
    rival_iterations: int = limit(
        300,
        "RANSAC iterations of a rival's first pose.",
        chosen="A rival that matters holds a third of what is left or more: 300 samples of three find it.",
    )
    estimator: Literal["lo_ransac", "epnp_lm"] = "lo_ransac"
    fundamental_filter: bool = False
    fit_lens: bool = True
    check_intrinsics: bool = True
    second_look: bool = True
    limits: Limits | None = None


# Paper A, 2.3: the best keyframe alone, fundamental-matrix RANSAC, EPnP and Levenberg-Marquardt, no abstention
# beyond what the estimator needs.
PAPER = LocalizerSettings(
    keyframes=1,
    other_places=0,
    look_alikes=0,
    covisible=0,
    second_attempt=0,
    estimator="epnp_lm",
    fundamental_filter=True,
    fit_lens=False,
    check_intrinsics=False,
    second_look=False,
    limits=Limits.none(),
)
