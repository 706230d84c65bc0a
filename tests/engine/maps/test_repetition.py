"""What in a map looks like something elsewhere in it, features without points included."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.maps.repetition import OPTIONS, Unplaced, elsewhere
from tests.scenes import pose_at

COUNT = 60
# The third keyframe is 20 m away and looks the other way.
POSES = [pose_at(0.0, 0.0), pose_at(2.0, 0.0), pose_at(20.0, 0.0, yaw_deg=180.0)]
rng = np.random.default_rng(4)
PRINTS = rng.uniform(0, 255, (2 * COUNT, 128)).astype(np.uint8)
POINTS = rng.uniform(-0.5, 0.5, (2 * COUNT, 3)).astype(np.float32)
OFFSETS = np.array([0, COUNT, 2 * COUNT, 2 * COUNT])


def unplaced(cosine: float) -> Unplaced:
    """Return look-alikes of the first keyframe's features in the third one, which has this cosine to the others."""
    other = [cosine, float(np.sqrt(1 - cosine**2))]
    return Unplaced(
        descriptors=PRINTS[:COUNT],
        keyframes=np.full(COUNT, 2),
        rays_in_camera=np.tile([0.0, 0.0, 1.0], (COUNT, 1)),
        global_descriptors=np.array([[1.0, 0.0], [1.0, 0.0], other], np.float32),
    )


@pytest.mark.parametrize("is_alike", [True, False])
def test_what_resembles_a_feature_without_a_point_is_not_distinct_where_keyframes_look_alike(
    is_alike: bool,
) -> None:
    cosine = OPTIONS.min_alike_cosine + (0.01 if is_alike else -0.01)
    before, nobody = elsewhere(PRINTS, False, POINTS, OFFSETS, POSES)
    distance, keyframe = elsewhere(PRINTS, False, POINTS, OFFSETS, POSES, unplaced=unplaced(cosine))
    assert (nobody == -1).all()
    assert (keyframe[:COUNT] == (2 if is_alike else -1)).all()
    assert ((distance[:COUNT] < 0.01) == is_alike).all()
    assert (distance <= before).all()


def test_only_views_of_their_own_are_searched() -> None:
    """A keyframe beside another one is the same view: its features are not asked for."""
    poses = [*POSES[:2], pose_at(2.0, 0.0)]
    found = elsewhere(PRINTS, False, POINTS, OFFSETS, poses, unplaced=unplaced(1.0))[1]
    assert (found == -1).all()
