"""Which way is up, by how a camera is held: most pictures are upright, or nearly so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.examination.outcome import Finding
from app.importers.conventions import PoseArrays
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class UprightOptions:
    """When gravity contradicts how the camera was held."""

    hanging_cosine: float = limit(
        -0.5,
        "The usual cosine between a picture's lower side and gravity, below which the pictures hang upside down.",
        chosen="By hand: nobody scans so; a camera that looks at the floor or the ceiling has one near zero.",
    )
    clear_share: float = limit(
        0.6,
        "Length of the mean of the pictures' down directions from which the scan shows which way is down.",
        chosen="By hand: a camera that is turned about its axis all the time leaves less.",
    )
    z_cosine: float = limit(
        0.7, "Cosine between that mean and -z below which z does not point up.", chosen="By hand: 45 degrees."
    )


OPTIONS = UprightOptions()
_AXES = ("x", "y", "z")


def judge_gravity(
    poses: PoseArrays, gravity: tuple[float, float, float] | None, *, asked: bool
) -> list[Finding]:
    """Return what is wrong with gravity, the direction of down in the frame of the poses (None: not known).

    `asked` says that without gravity z would have to point up for plan positions.
    """
    down = poses.rotations[:, :, 1]
    if gravity is not None:
        return _against(down, np.array(gravity) / np.linalg.norm(gravity))
    return _without(down) if asked else []


def _against(down: Array, gravity: Array) -> list[Finding]:
    cosine = float(np.median(down @ gravity))
    if cosine > OPTIONS.hanging_cosine:
        return []
    right = [round(-value, 6) + 0.0 for value in gravity.tolist()]
    return [
        Finding(
            code="gravity_up",
            sentence="By its gravity nearly all pictures of the scan hang upside down: gravity must point down, and "
            f'this one points up; give "gravity": {right}.',
            options={"gravity": right},
            certain=True,
            figures={"gravity_cosine": round(cosine, 3)},
        )
    ]


def _without(down: Array) -> list[Finding]:
    mean = down.mean(axis=0)
    length = float(np.linalg.norm(mean))
    if length < OPTIONS.clear_share or -mean[2] / length > OPTIONS.z_cosine:
        return []
    axis = int(np.argmax(np.abs(mean)))
    guess = [0, 0, 0]
    guess[axis] = 1 if mean[axis] > 0 else -1
    return [
        Finding(
            code="up_is_not_z",
            severity="doubtful",
            sentence="The scan's z axis does not point up: by its pictures down is nearest to "
            f"{'+' if mean[axis] > 0 else '-'}{_AXES[axis]}. Without gravity there are no plan positions; give "
            f'"gravity": {guess} if that is down.',
            options={"gravity": guess},
            figures={"down_cosine": round(float(abs(mean[axis]) / length), 3)},
        )
    ]
