"""Which modules are mutated, and the tests that must notice."""

from __future__ import annotations

from dataclasses import dataclass

QUERY = "tests/engine/query"
TRACKING = "tests/engine/tracking"
SERVICES = "tests/services"
MUSEUM = f"{QUERY}/test_abstention.py::test_a_room_that_is_in_the_map_twice_is_ambiguous"


@dataclass(frozen=True, slots=True)
class Target:
    """A module by its file, the arguments that let pytest run its tests, fast ones first, and the functions that are
    mutated: all where none is named."""

    path: str
    tests: tuple[str, ...]
    functions: tuple[str, ...] = ()


TARGETS = (
    Target(
        "app/engine/query/verification.py",
        (
            f"{QUERY}/test_verification.py",
            f"{QUERY}/test_abstention.py",
            f"--deselect={MUSEUM}",
        ),
    ),
    Target(
        "app/engine/query/contradiction.py",
        (f"{QUERY}/test_contradiction.py",),
    ),
    Target(
        "app/engine/query/accuracy.py",
        (f"{QUERY}/test_accuracy.py",),
    ),
    Target(
        "app/engine/query/camera.py",
        (f"{QUERY}/test_query_camera.py",),
    ),
    Target(
        "app/engine/tracking/tracker.py",
        (f"{TRACKING}/test_belief.py", f"{TRACKING}/test_confirmation.py"),
        (
            "Tracker._search",
            "Tracker._just_searched",
            "Tracker._near_last",
            "Tracker._can_be",
            "Tracker._is_plausible",
            "Tracker._is_confirmed",
            "Tracker._may_be_elsewhere",
            "Tracker._is_near",
            "Tracker._doubt",
        ),
    ),
    Target(
        "app/storage/maps.py",
        ("tests/storage/test_maps.py",),
    ),
    Target(
        "app/services/run_build.py",
        (f"{SERVICES}/test_publishing.py", f"{SERVICES}/test_run_build.py"),
    ),
)
