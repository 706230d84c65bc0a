"""The user on the plan by lines through keyframes, and by the keyframes' own poses where lines say nothing."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.query.vdm.keyframe_fix import KeyframeFix, fix_by_keyframe
from app.engine.query.vdm.keyframe_matches import KeyframeMatches
from app.engine.query.vdm.user_lines import user_on_plan
from tests.scenes import CAMERA, pose_at

USER = pose_at(2.0, 1.5, 1.4, 20.0)


def matches(seed: int, count: int = 120, noise_px: float = 0.5, wrong: int = 20) -> KeyframeMatches:
    """Return what a keyframe and the user both see: points before the user, pixels with noise, some of them wrong."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform([0, 0], [CAMERA.width - 1, CAMERA.height - 1], (count, 2))
    points = USER.apply(CAMERA.unproject(pixels, rng.uniform(1.0, 4.0, count)))
    pixels = pixels + rng.normal(size=pixels.shape) * noise_px
    pixels[:wrong] = rng.uniform([0, 0], [CAMERA.width - 1, CAMERA.height - 1], (wrong, 2))
    return KeyframeMatches(
        keyframe=seed,
        query_rows=np.arange(count),
        query_px=pixels,
        keyframe_px=pixels,
        points_in_world=points,
        sigma_m=np.full(count, 0.005),
        distinct=np.ones(count, bool),
    )


def fix(seed: int, x: float, y: float, **options: float) -> KeyframeFix:
    found = fix_by_keyframe(matches(seed, **options), pose_at(x, y, 1.4, 25.0), CAMERA, 3.0)  # type: ignore[arg-type]
    assert found is not None
    return found


def off_m(fixes: list[KeyframeFix]) -> float:
    place = user_on_plan(fixes)
    return float(np.hypot(place.x - USER.translation[0], place.y - USER.translation[1]))


def test_one_keyframe_gives_the_users_pose() -> None:
    found = fix(0, 1.0, 1.0)
    assert np.linalg.norm(found.world_from_user.translation - USER.translation) < 0.03
    assert len(found.inliers) >= 95
    own = np.sqrt(np.trace(found.covariance[3:, 3:]))
    assert np.linalg.norm(found.world_from_user.translation - USER.translation) < 5 * own


def test_lines_from_keyframes_around_cross_at_the_user() -> None:
    fixes = [fix(i, *place) for i, place in enumerate([(1.0, 1.4), (2.1, 0.4), (1.2, 0.7), (2.9, 0.8)])]
    place = user_on_plan(fixes)
    assert place.by_lines
    assert off_m(fixes) < 0.03
    assert off_m(fixes) < 6 * place.sigma_m


@pytest.mark.parametrize("count", [1, 2, 4])
def test_lines_in_one_row_with_the_user_say_nothing_so_depth_does(count: int) -> None:
    # All on the line y = 1.5, on which the user stands too.
    fixes = [fix(i, 0.5 + 0.3 * i, 1.5) for i in range(count)]
    place = user_on_plan(fixes)
    assert not place.by_lines
    assert off_m(fixes) < 0.03


def test_a_keyframe_in_the_users_own_place_does_no_harm() -> None:
    fixes = [fix(0, 2.0, 1.5), fix(1, 1.0, 1.4), fix(2, 2.1, 0.4)]
    assert off_m(fixes) < 0.03


def test_sigma_covers_the_error() -> None:
    rng = np.random.default_rng(4)
    within = 0
    for i in range(40):
        places = [(2.0 + rng.uniform(-1, 1), 1.5 + rng.uniform(-1, 1)) for _ in range(4)]
        fixes = [fix(4 * i + k, *place, noise_px=1.0) for k, place in enumerate(places)]
        within += off_m(fixes) < 2 * user_on_plan(fixes).sigma_m
    assert within >= 34


def test_matches_that_agree_on_nothing_give_no_fix() -> None:
    rng = np.random.default_rng(2)
    none = matches(0, count=40, wrong=40)
    assert fix_by_keyframe(none, pose_at(1, 1), CAMERA, 3.0) is None
    few = none.take(rng.random(40) < 0.05)
    assert fix_by_keyframe(few, pose_at(1, 1), CAMERA, 3.0) is None
