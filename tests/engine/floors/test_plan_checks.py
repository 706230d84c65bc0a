"""A plan_from_world is judged: what a survey leaves is taken, the usual mistakes are refused and named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.floors.plan_alignment import parse_plan_from_world
from app.errors import InvalidInputError

Array = NDArray[np.float64]
HEIGHT_M = 3.5


def survey(
    seed: int, count: int, noise_m: float, size_m: tuple[float, float] = (20.0, 12.0)
) -> tuple[Array, Array]:
    """Return world points (n, 3) of a floor and their plan points (n, 2), picked with errors of `noise_m`."""
    random = np.random.default_rng(seed)
    # Corners of the floor, each a little inside, so that the points are never on one line.
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0], [0.5, 1]])[:count]
    ground = (corners + random.uniform(0.0, 0.2, (count, 2))) * size_m
    yaw = random.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    plan = random.uniform(0.97, 1.03) * ground @ turn.T + random.uniform(-50, 50, 2)
    heights = random.uniform(0.0, 2.0, count)
    return np.column_stack([ground, heights]), plan + random.normal(0.0, noise_m, plan.shape)


def pairs(world: Array, plan: Array) -> dict[str, Any]:
    return {
        "correspondences": [
            {"world": a, "plan": b} for a, b in zip(world.tolist(), plan.tolist(), strict=True)
        ]
    }


def refusal(value: object) -> str:
    with pytest.raises(InvalidInputError) as caught:
        parse_plan_from_world(value, HEIGHT_M)
    assert len(str(caught.value)) < 500
    return str(caught.value)


@pytest.mark.parametrize("count", [2, 3, 4, 6])
@pytest.mark.parametrize("size_m", [(3.0, 2.0), (20.0, 12.0), (80.0, 5.0)])
def test_right_surveys_are_taken(count: int, size_m: tuple[float, float]) -> None:
    for seed in range(100):
        world, plan = survey(seed, count, 0.02 if size_m[0] < 10 else 0.15, size_m)
        found = parse_plan_from_world(pairs(world, plan), HEIGHT_M)
        assert found is not None
        assert 0.8 < found.scale < 1.25


def pixels(world: Array, plan: Array) -> tuple[Array, Array]:
    return world, plan * [50.0, -50.0] + [100.0, 900.0]


def y_up(world: Array, plan: Array) -> tuple[Array, Array]:
    return np.column_stack([world[:, 0], world[:, 2], -world[:, 1]]), plan


def y_down(world: Array, plan: Array) -> tuple[Array, Array]:
    return np.column_stack([world[:, 0], -world[:, 2], world[:, 1]]), plan


def x_up(world: Array, plan: Array) -> tuple[Array, Array]:
    return np.column_stack([world[:, 2], world[:, 0], world[:, 1]]), plan


MISTAKES: dict[str, tuple[Any, tuple[str, ...]]] = {
    "pixels, v down": (pixels, ("Mirrored they fit", "pixels with v pointing down", "y = -v / ")),
    "pixels, y up": (lambda w, p: (w, p * 60.0), ("pixels: give them in metres, divided by",)),
    "millimetres": (lambda w, p: (w, p * 1000.0), ("millimetres",)),
    "feet": (lambda w, p: (w, p * 3.2808), ("feet",)),
    "y down": (lambda w, p: (w, p * [1.0, -1.0]), ("Mirrored they fit within", "is y of the plan up?")),
    "x and y exchanged": (lambda w, p: (w, p[:, ::-1]), ("Mirrored they fit within",)),
    "y-up world": (y_up, ("(x, -z)", "y of the world is vertical", "gravity")),
    "y-down world": (y_down, ("(x, z)", "y of the world is vertical")),
    "x-up world": (x_up, ("(y, z)", "x of the world is vertical")),
    "y-up world and pixels": (lambda w, p: pixels(*y_up(w, p)), ("y of the world is vertical", "pixels")),
    "world in millimetres": (lambda w, p: (w * 1000.0, p), ("the world is in millimetres",)),
    "drawing 1:50": (lambda w, p: (w, p / 50.0), ("reduced scale",)),
    "half the size": (lambda w, p: (w, p * 0.6), ("not true to size",)),
}


@pytest.mark.parametrize("count", [3, 4, 6])
@pytest.mark.parametrize("mistake", MISTAKES)
def test_the_usual_mistakes_are_named(mistake: str, count: int) -> None:
    change, hints = MISTAKES[mistake]
    for seed in range(30):
        sentence = refusal(pairs(*change(*survey(seed, count, 0.05))))
        assert all(hint in sentence for hint in hints), sentence


def test_mirrored_points_without_any_fit_are_named() -> None:
    square = np.array([[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0]], dtype=float)
    assert "Mirrored they fit within 0.00 m:" in refusal(pairs(square, square[:, :2] * [1, -1]))


def test_mirrored_points_of_a_short_corridor_are_named() -> None:
    # Their residual is one that picking points could leave, but the mirrored fit is far better.
    for seed in range(30):
        world, plan = survey(seed, 4, 0.005, (3.0, 0.3))
        sentence = refusal(pairs(world, plan * [1.0, -1.0]))
        assert "contradict each other" in sentence
        assert "Mirrored they fit within 0.0" in sentence


def test_a_y_up_world_is_named_when_its_points_fit_at_another_scale() -> None:
    # Along a diagonal: x and the height alone fit too, at 1.4 times the size.
    world = np.array([[0.0, 1.5, 0.0], [5.0, 1.5, -5.0], [10.0, 1.5, -10.1]])
    plan = np.array([[0.0, 0.0], [5.0, 5.0], [10.0, 10.1]])
    sentence = refusal(pairs(world, plan))
    assert "give 1.4" in sentence
    assert "y of the world is vertical" in sentence


def test_an_axis_that_puts_the_points_on_several_floors_is_not_vertical() -> None:
    # With y vertical they would fit, but y differs by as much as a house is high.
    world = np.array([[0.0, 0.0, 0.0], [10.0, 12.0, 1.0], [5.0, 20.0, 2.0]])
    plan = np.column_stack([world[:, 0], -world[:, 2]])
    assert "is vertical" not in refusal(pairs(world, plan))


def test_one_wrong_pair_is_named() -> None:
    for seed in range(30):
        world, plan = survey(seed, 6, 0.05)
        plan[4] += [9.0, -4.0]
        assert "Without correspondences[4] the others fit within 0." in refusal(pairs(world, plan))


def test_a_stretched_drawing_is_named() -> None:
    world, _ = survey(1, 6, 0.0)
    sentence = refusal(pairs(world, world[:, :2] * [1.0, 1.6]))
    assert "scale 1 along x and 1.6 along y" in sentence
    assert "aspect ratio" in sentence


def test_points_that_belong_to_nothing_get_advice() -> None:
    world = np.array([[0, 0, 0], [10, 0, 0], [10, 6, 0], [0, 6, 0], [3, 2, 0]], dtype=float)
    plan = np.array([[1, 5], [8, 2], [0, 9], [7, 7], [3, 1]], dtype=float)
    assert "Check that the pairs belong together" in refusal(pairs(world, plan))


def test_two_points_on_different_heights_show_a_y_up_world() -> None:
    world = np.array([[0.0, 1.5, 0.0], [10.0, 1.5, -6.0]])
    plan = np.array([[2.0, 1.0], [12.0, 7.0]])
    sentence = refusal(pairs(world, plan))
    assert "differ in z by 6 m" in sentence
    assert "(x, -z)" in sentence
    # Without the height of the floor, or within it, nothing is known.
    assert parse_plan_from_world(pairs(world, plan)) is not None
    assert parse_plan_from_world(pairs(world, plan), 8.0) is not None


def degrees(points: Array) -> Array:
    """Return longitude and latitude of points (n, 2) in metres, in Berlin."""
    return np.array([13.377, 52.516]) + points / [67_800.0, 111_250.0]


@pytest.mark.parametrize("count", [2, 3, 4, 6])
def test_longitude_and_latitude_are_named(count: int) -> None:
    world, plan = survey(5, count, 0.05)
    for in_degrees in (degrees(plan), degrees(plan)[:, ::-1]):
        assert "The plan points look like longitude and latitude" in refusal(pairs(world, in_degrees))
    ground = np.column_stack([degrees(world[:, :2]), world[:, 2]])
    assert "The world points look like longitude and latitude" in refusal(pairs(ground, plan))


def test_a_drawing_to_a_reduced_scale_is_not_taken_for_degrees() -> None:
    world, plan = survey(5, 4, 0.0)
    assert "reduced scale" in refusal(pairs(world, (plan - plan.mean(axis=0)) / 20_000))


def test_points_of_several_floors_are_taken_together() -> None:
    world, plan = survey(3, 6, 0.05)
    world[:, 2] += [0, 0, 4, 4, 8, 8]
    assert parse_plan_from_world(pairs(world, plan), HEIGHT_M) is not None


def matrix(x: float, y: float, z: float) -> Array:
    return np.diag([x, y, z, 1.0])


MATRICES: dict[str, tuple[Array, str]] = {
    "pixels": (matrix(50, -50, 1), "pixels with v pointing down"),
    "pixels, y up": (matrix(40, 40, 40), "divided by 40"),
    "flat pixels": (matrix(40, 40, 1), "divided by 40"),
    "centimetres": (matrix(100, 100, 100), "centimetres, or pixels"),
    "reduced": (matrix(0.01, 0.01, 0.01), "reduced scale"),
    "half": (matrix(0.7, 0.7, 0.7), "not true to size"),
    "mirrored": (matrix(1, -1, 1), "mirrors the world"),
    "far away": (matrix(1, 1, 1) + np.eye(4, k=3) * 1e9, "at most 100,000,000"),
    "transposed": (np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [4, 5, 0, 1.0]]), "transposed"),
    "y up": (
        np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]),
        "takes y of the world as vertical",
    ),
}


@pytest.mark.parametrize("name", MATRICES)
def test_matrices_that_no_plan_has(name: str) -> None:
    value, hint = MATRICES[name]
    assert hint in refusal(value.tolist())


def test_a_matrix_true_to_size_is_taken() -> None:
    turned = [[0, -1.1, 0, 5], [1.1, 0, 0, 2], [0, 0, 1.1, 0], [0, 0, 0, 1]]
    found = parse_plan_from_world(turned, HEIGHT_M)
    assert found is not None
    assert found.scale == pytest.approx(1.1)
