"""What in a picture speaks against a pose."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.query.contradiction import GRID, contradicted_share
from app.geometry.se3 import Pose
from app.vision.matching import to_unit_vectors
from tests.maps import map_of
from tests.scenes import CAMERA, pose_at

HERE = pose_at(0.0, 0.0)
COUNT = 4000
rng = np.random.default_rng(0)
PIXELS = rng.uniform([0, 0], [CAMERA.width - 1, CAMERA.height - 1], (COUNT, 2))
# SIFT's numbers are few large and many small ones.
PRINTS = (rng.exponential(30, (2, COUNT, 128)) ** 1.5 / 10).clip(0, 255).astype(np.uint8)
POINTS = HERE.apply(CAMERA.unproject(PIXELS, np.full(COUNT, 2.0)))
MAP = map_of([HERE], [POINTS], [PRINTS[0]])
LEFT = PIXELS[:, 0] < CAMERA.width / 2


def share(
    features: np.ndarray, inliers: np.ndarray, prints: np.ndarray = PRINTS[0], seen_from_m: float = 0.0
) -> float:
    pose = pose_at(seen_from_m, 0.0)
    unit = to_unit_vectors(prints[features], binary=False)
    return contradicted_share(MAP, [0], pose, CAMERA, (PIXELS[features], unit), PIXELS[inliers], False)


def test_what_is_there_contradicts_nothing() -> None:
    assert share(np.full(COUNT, True), LEFT) == 0.0


def test_another_print_where_the_map_has_one_contradicts() -> None:
    changed = np.where(LEFT[:, None], PRINTS[0], PRINTS[1])
    assert share(np.full(COUNT, True), LEFT, changed) == pytest.approx(0.5, abs=0.02)


def test_what_is_hidden_contradicts_nothing() -> None:
    assert share(LEFT, LEFT) == 0.0


def test_what_was_scanned_from_far_away_is_not_expected() -> None:
    # At half the distance the picture shows other features than the keyframe does.
    assert share(np.full(COUNT, True), LEFT, PRINTS[1], seen_from_m=1.0) == 0.0


def test_a_pose_that_no_keyframe_shares_a_view_with_is_not_judged() -> None:
    features = PIXELS, to_unit_vectors(PRINTS[1], binary=False)
    assert contradicted_share(MAP, [], HERE, CAMERA, features, PIXELS[LEFT], False) == 0.0


def of_cells(expected: int, own: int, shared: int) -> float:
    """Return the share that contradicts where each cell of the right half has `expected` features in the map and `own`
    ones in the picture, `shared` of them the same, and each cell of the left half an inlier."""
    drawn = np.random.default_rng(1)
    size_px = np.array([CAMERA.width, CAMERA.height]) / GRID
    corners = np.array([(x, y) for x in range(GRID[0] // 2, GRID[0]) for y in range(GRID[1])]) * size_px

    def made(count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return pixels (cells, count, 2) and descriptors (cells, count, 128) of new features in each cell."""
        pixels = corners[:, None] + drawn.uniform(0.1, 0.9, (len(corners), count, 2)) * size_px
        prints = (drawn.exponential(30, (len(corners), count, 128)) ** 1.5 / 10).clip(0, 255)
        return pixels, prints.astype(np.uint8)

    map_px, map_prints = made(expected)
    new_px, new_prints = made(own - shared)
    points = HERE.apply(CAMERA.unproject(map_px.reshape(-1, 2), np.full(map_px.size // 2, 2.0)))
    pixels = np.concatenate([map_px[:, :shared], new_px], axis=1).reshape(-1, 2)
    prints = np.concatenate([map_prints[:, :shared], new_prints], axis=1).reshape(-1, 128)
    mapped = map_of([HERE], [points], [map_prints.reshape(-1, 128)])
    features = pixels, to_unit_vectors(prints, binary=False)
    left = (np.array([(x, y) for x in range(GRID[0] // 2) for y in range(GRID[1])]) + 0.5) * size_px
    return contradicted_share(mapped, [0], HERE, CAMERA, features, left, False)


@pytest.mark.parametrize(
    ("expected", "own", "shared", "share"),
    [
        (60, 60, 0, 0.5),
        # A blurred picture shows a twelfth of the map's features, and nothing else.
        (60, 5, 5, 0.0),
        (60, 5, 0, 0.5),
        # A sharp one shows all of the map's and twelve times as many.
        (12, 150, 12, 0.0),
        (12, 150, 0, 0.5),
        # A tenth of either in the other is still chance, a little more is not.
        (50, 50, 5, 0.5),
        (50, 50, 6, 0.0),
        # Too few in the map or in the picture say nothing.
        (10, 4, 0, 0.5),
        (9, 40, 0, 0.0),
        (40, 3, 0, 0.0),
    ],
)
def test_map_and_picture_must_both_lack_what_the_other_has(
    expected: int, own: int, shared: int, share: float
) -> None:
    assert of_cells(expected, own, shared) == share


def test_what_the_pose_sees_from_the_other_side_is_not_expected() -> None:
    # The wall that the map knows, at the same distance, from behind it.
    behind = Pose(HERE.rotation @ np.diag([-1.0, 1.0, -1.0]), HERE.translation + np.array([4.0, 0.0, 0.0]))
    features = PIXELS, to_unit_vectors(PRINTS[1], binary=False)
    assert contradicted_share(MAP, [0], behind, CAMERA, features, PIXELS[LEFT], False) == 0.0
    assert contradicted_share(MAP, [0], HERE, CAMERA, features, PIXELS[LEFT], False) > 0.4
