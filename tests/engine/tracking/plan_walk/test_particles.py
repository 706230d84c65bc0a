"""Particles: how their spread grows, how a fix and walls narrow it, and that the truth stays within it."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.floors.collection import read_collection
from app.engine.floors.walls import FloorWalls
from app.engine.tracking.plan_walk.particles import Particles, PlanFix, PlanMotion
from tests.plans import GROUND, UPPER, collection, landmark

FIX_SIGMA_M = 0.2


def walls() -> dict[str, FloorWalls | None]:
    """Return the walls of two floors."""
    plans = {"ground": GROUND, "upper": UPPER}
    return {
        name: FloorWalls.of(read_collection(plan, name)[1], lambda points: points)
        for name, plan in plans.items()
    }


def fix_at(x: float, y: float, yaw_deg: float = 0.0, sigma_m: float = FIX_SIGMA_M) -> PlanFix:
    """Return a fix on the ground floor."""
    return PlanFix(
        floor="ground",
        xy=np.array([x, y]),
        yaw_rad=float(np.radians(yaw_deg)),
        position_sigma_m=sigma_m,
        yaw_sigma_rad=0.03,
    )


def step(ahead_m: float, turn_deg: float = 0.0) -> PlanMotion:
    """Return a step of a walker with the errors that odometry has."""
    return PlanMotion(
        moved=np.array([ahead_m, 0.0]),
        moved_sigma_m=0.04,
        turned_rad=float(np.radians(turn_deg)),
        turned_sigma_rad=0.01,
    )


def test_particles_begin_at_a_fix_and_spread_with_the_path() -> None:
    particles = Particles({"ground": None}, fix_at(0.0, 0.0))
    begun = particles.belief()
    assert begun.position_sigma_m == pytest.approx(FIX_SIGMA_M, rel=0.1)
    for _ in range(20):
        particles.move(step(0.3))
    after = particles.belief()
    assert np.linalg.norm(after.xy - [6.0, 0.0]) < 0.1
    # A scale known to 7 % that changes every 5 m is about 0.35 m after 6 m; steps and the fix add to it.
    assert 0.35 < after.position_sigma_m < 0.55


def test_a_fix_corrects_the_place_and_what_is_known_of_the_scale() -> None:
    particles = Particles({"ground": None}, fix_at(0.0, 0.0, sigma_m=0.05))
    for _ in range(20):
        particles.move(step(0.3))
    before = float(np.mean(particles.log_scale))
    particles.correct(fix_at(6.5, 0.0, sigma_m=0.05))
    belief = particles.belief()
    assert np.linalg.norm(belief.xy - [6.5, 0.0]) < 0.05
    assert belief.position_sigma_m < 0.1
    # Odometry was 8 % short; the last metres say most of the scale that it has now.
    assert np.mean(particles.log_scale) > before + 0.03


def test_a_fix_far_away_finds_no_particles() -> None:
    particles = Particles({"ground": None}, fix_at(0.0, 0.0))
    assert particles.share_near(fix_at(0.2, 0.1), 3.0) > 0.5
    assert particles.share_near(fix_at(3.0, 0.0), 3.0) == 0.0
    assert particles.share_near(fix_at(0.0, 0.0, yaw_deg=40.0), 3.0) == 0.0


def test_a_corridor_keeps_its_walker_and_straightens_the_direction() -> None:
    free, walled = (Particles(each, fix_at(2.0, 1.0, yaw_deg=6.0)) for each in ({"ground": None}, walls()))
    for _ in range(40):
        for particles in (free, walled):
            particles.move(step(0.3))
    # Odometry's direction is six degrees to the left: 1.3 m aside after 12 m, in a corridor of 2 m.
    assert free.belief().xy[1] > 2.0
    assert 0.0 < walled.belief().xy[1] < 2.0
    assert np.degrees(walled.belief().yaw_rad) < np.degrees(free.belief().yaw_rad)


def test_who_climbs_the_stairs_is_on_the_other_floor_from_their_middle_on() -> None:
    particles = Particles(walls(), fix_at(18.0, 1.0, yaw_deg=180.0, sigma_m=0.05))
    floors, shares = [], []
    for _ in range(10):
        particles.move(step(0.3))
        floors.append(particles.belief().floor)
        shares.append(particles.belief().floor_share)
    assert floors[:5] == ["ground"] * 5
    assert floors[-2:] == ["upper"] * 2
    assert min(shares[:4]) > 0.95
    assert min(shares) < 0.8
    assert shares[-1] > 0.95


def test_without_areas_nothing_stops_a_walker() -> None:
    plan = collection(landmark("a", 1, 1))
    bare = FloorWalls.of(read_collection(plan, "ground")[1], lambda points: points)
    particles = Particles({"ground": bare}, fix_at(0.0, 0.0))
    particles.move(step(0.3))
    assert np.linalg.norm(particles.belief().xy - [0.3, 0.0]) < 0.05
