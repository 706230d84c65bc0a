"""One answer from several frames of a burst or a rig."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from app.engine.query.localization import Localization
from app.engine.query.localizer import Localizer
from app.engine.query.several.frame import GivenFrame, ask_alone
from app.engine.query.several.with_motion import locate_with_motion
from app.engine.query.several.without_motion import locate_without_motion
from app.errors import InvalidInputError
from app.geometry.camera import Camera


def localize_several(
    localizer: Localizer, frames: Sequence[GivenFrame], allowed: NDArray[np.int64] | None = None
) -> Localization:
    """Localize frame 0 by all frames, whose motion is known for all or for none; `allowed` restricts retrieval.

    Pose, accuracy, camera and inliers of the answer are those of frame 0 as given. Raises `InvalidInputError` for a
    motion of frames whose cameras are not all stated.
    """
    knows_motion = all(frame.first_from_camera is not None for frame in frames)
    if knows_motion and not all(isinstance(frame.camera, Camera) for frame in frames):
        raise InvalidInputError("Frames with a motion need their intrinsics: send camera, or cameras.")
    asked = [ask_alone(localizer, frame, allowed) for frame in frames]
    return (locate_with_motion if knows_motion else locate_without_motion)(localizer, asked)
