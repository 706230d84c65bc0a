"""What in a picture speaks against a pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.maps.open_map import OpenMap
from app.engine.maps.vision_models import VisionModels
from app.engine.query.contradiction import cells_of, contradicted_in_map
from app.geometry.se3 import Pose
from app.vision.index import GlobalIndex
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
# Columns and rows that a picture is divided into.
GRID = (12, 9)


def share(
    features: np.ndarray, inliers: np.ndarray, prints: np.ndarray = PRINTS[0], seen_from_m: float = 0.0
) -> float:
    pose = pose_at(seen_from_m, 0.0)
    unit = to_unit_vectors(prints[features], binary=False)
    return cells_of(
        MAP, [0], pose, CAMERA, (PIXELS[features], unit), PIXELS[inliers], False
    ).contradicted_share


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
    assert cells_of(MAP, [], HERE, CAMERA, features, PIXELS[LEFT], False).contradicted_share == 0.0


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
    return cells_of(mapped, [0], HERE, CAMERA, features, left, False).contradicted_share


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


def test_a_cell_that_holds_an_inlier_does_not_contradict() -> None:
    # Something else hangs in the right half, but a little of the old print agrees all over it.
    changed = np.where(LEFT[:, None], PRINTS[0], PRINTS[1])
    assert share(np.full(COUNT, True), np.full(COUNT, True), changed) == 0.0


def test_nothing_at_all_contradicts_nothing() -> None:
    none = np.full(COUNT, False)
    assert share(none, none) == 0.0


def around(degrees: float, distance_m: float = 2.0) -> Pose:
    """Return a pose that faces the middle of the wall from a distance, so many degrees beside it."""
    angle = np.radians(degrees)
    return pose_at(
        2.0 - distance_m * float(np.cos(angle)), distance_m * float(np.sin(angle)), yaw_deg=-degrees
    )


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        (around(15.0), True),
        (around(-15.0), True),
        (around(45.0), False),
        (around(0.0, 1.5), True),
        (around(0.0, 0.9), False),
        (around(0.0, 3.0), True),
        (around(0.0, 3.7), False),
    ],
    ids=["15 degrees", "-15 degrees", "45 degrees", "1.5 m", "0.9 m", "3 m", "3.7 m"],
)
def test_what_is_seen_about_as_the_keyframe_saw_it_is_expected(pose: Pose, expected: bool) -> None:
    # Another print all over, and an inlier in the cell of a corner.
    features = PIXELS, to_unit_vectors(PRINTS[1], binary=False)
    found = cells_of(MAP, [0], pose, CAMERA, features, np.array([[1.0, 1.0]]), False).contradicted_share
    assert found > 0.9 if expected else found == 0.0


# Places of features six pixels apart, so that each has none but its own around it.
LATTICE = np.array([(x, y) for x in np.arange(163.0, 318.0, 6.0) for y in np.arange(3.0, 238.0, 6.0)])
DRAWN = np.random.default_rng(3)
LATTICE_PRINTS = DRAWN.normal(size=(len(LATTICE), 128))


def lattice_share(shift_px: float = 0.0, nearer: int = 0, differing: float = 0.0) -> float:
    """Return the share that contradicts when the features of the right half are `shift_px` from where they are
    expected, with `nearer` others in between, and their unit descriptors differ by a distance from those of the map.
    """
    side = DRAWN.normal(size=LATTICE_PRINTS.shape)
    mapped = LATTICE_PRINTS / np.linalg.norm(LATTICE_PRINTS, axis=1, keepdims=True)
    side -= np.einsum("ij,ij->i", side, mapped)[:, None] * mapped
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    cosine = 1 - differing**2 / 2
    unit = cosine * mapped + np.sqrt(1 - cosine**2) * side
    decoys_px = np.repeat(LATTICE, nearer, axis=0) + DRAWN.uniform(-0.3, 0.3, (nearer * len(LATTICE), 2))
    decoys = DRAWN.normal(size=(len(decoys_px), 128))
    decoys /= np.linalg.norm(decoys, axis=1, keepdims=True)
    points = HERE.apply(CAMERA.unproject(LATTICE, np.full(len(LATTICE), 2.0)))
    known = map_of([HERE], [points], [mapped.astype(np.float32)])
    pixels = np.concatenate([LATTICE + np.array([shift_px, 0.0]), decoys_px])
    features = pixels, np.concatenate([unit, decoys]).astype(np.float32)
    return cells_of(known, [0], HERE, CAMERA, features, PIXELS[LEFT], False).contradicted_share


def test_a_feature_is_found_where_it_is_expected_or_close_by() -> None:
    assert lattice_share() == lattice_share(shift_px=2.0) == 0.0
    # Half of the picture: all cells of it contradict.
    assert lattice_share(shift_px=2.9) == pytest.approx(0.5, abs=0.02)


def test_a_feature_is_found_among_the_nearest() -> None:
    assert lattice_share(shift_px=1.0, nearer=4) == 0.0
    assert lattice_share(shift_px=1.0, nearer=8) == pytest.approx(0.5, abs=0.02)


def test_a_feature_is_known_by_a_descriptor_that_is_much_the_same() -> None:
    assert lattice_share(differing=0.7) == 0.0
    assert lattice_share(differing=0.8) == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(("flipped", "share"), [(0.0, 0.0), (0.2, 0.0), (0.35, 0.5), (0.5, 0.5)])
def test_binary_descriptors_are_known_by_most_of_their_bits(flipped: float, share: float) -> None:
    drawn = np.random.default_rng(4)
    bits = drawn.integers(0, 2, (len(LATTICE), 256), np.uint8)
    changed = bits ^ (drawn.random(bits.shape) < flipped)
    points = HERE.apply(CAMERA.unproject(LATTICE, np.full(len(LATTICE), 2.0)))
    known = map_of([HERE], [points], [np.packbits(bits, axis=1)])
    features = LATTICE, to_unit_vectors(np.packbits(changed, axis=1), binary=True)
    found = cells_of(known, [0], HERE, CAMERA, features, PIXELS[LEFT], True).contradicted_share
    assert found == pytest.approx(share, abs=0.02)


def test_in_a_map_the_keyframes_that_see_what_the_pose_sees_are_asked() -> None:
    models = VisionModels()
    # Another wall, behind: from there none of the first is expected.
    away = pose_at(0.0, 0.0, yaw_deg=180.0)
    both = map_of([HERE, away], [POINTS, POINTS * [-1.0, 1.0, 1.0]], [PRINTS[0], PRINTS[1]])
    metadata = replace(both.metadata, descriptor_sha256=models.global_descriptor.sha256)
    index = GlobalIndex.from_descriptors(np.zeros((2, 8), np.float32))
    opened = OpenMap.of(replace(both, metadata=metadata), index, models)
    right, other = (
        (PIXELS, to_unit_vectors(np.where(LEFT[:, None], PRINTS[0], prints), binary=False))
        for prints in PRINTS
    )
    assert contradicted_in_map(opened, HERE, CAMERA, right, PIXELS[LEFT]) == 0.0
    assert contradicted_in_map(opened, HERE, CAMERA, other, PIXELS[LEFT]) == pytest.approx(0.5, abs=0.02)
    assert contradicted_in_map(opened, HERE, CAMERA, other, PIXELS[LEFT], np.array([1])) == 0.0


def test_what_the_pose_sees_from_the_other_side_is_not_expected() -> None:
    # The wall that the map knows, at the same distance, from behind it.
    behind = Pose(HERE.rotation @ np.diag([-1.0, 1.0, -1.0]), HERE.translation + np.array([4.0, 0.0, 0.0]))
    features = PIXELS, to_unit_vectors(PRINTS[1], binary=False)
    assert cells_of(MAP, [0], behind, CAMERA, features, PIXELS[LEFT], False).contradicted_share == 0.0
    assert cells_of(MAP, [0], HERE, CAMERA, features, PIXELS[LEFT], False).contradicted_share > 0.4
