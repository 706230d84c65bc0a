"""Which modules are mutated, and the tests that must notice."""

from __future__ import annotations

from dataclasses import dataclass

QUERY = "tests/engine/query"
TRACKING = "tests/engine/tracking"
SERVICES = "tests/services"
# For tests without fixtures of conftest.py, which import the whole application.
ALONE = "--noconftest"


@dataclass(frozen=True, slots=True)
class Target:
    """A module by its file, the arguments that let pytest run its tests, fast ones first, and the functions that are
    mutated: all where none is named."""

    path: str
    tests: tuple[str, ...]
    functions: tuple[str, ...] = ()


TARGETS = (
    Target("app/engine/query/verification.py", (ALONE, f"{QUERY}/test_verification.py")),
    Target("app/engine/query/contradiction.py", (ALONE, f"{QUERY}/test_contradiction.py")),
    Target("app/engine/query/accuracy.py", (ALONE, f"{QUERY}/test_accuracy.py")),
    Target(
        "app/engine/query/hypothesis.py",
        (ALONE, f"{QUERY}/test_hypothesis.py"),
        ("ViewOptions", "seen_from_one_side"),
    ),
    Target("app/engine/query/camera.py", (ALONE, f"{QUERY}/test_query_camera.py")),
    Target("app/engine/tracking/belief.py", (ALONE, f"{TRACKING}/test_belief.py")),
    Target("app/engine/tracking/drift.py", (ALONE, f"{TRACKING}/test_search.py"), ("reach_m",)),
    Target(
        "app/engine/tracking/tracker.py",
        (ALONE, f"{TRACKING}/test_belief.py", f"{TRACKING}/test_search.py"),
        (
            "Tracker._search",
            "Tracker._near_last",
            "Tracker._just_searched",
            "Tracker._doubt",
            "Tracker._miss",
        ),
    ),
    Target("app/storage/maps.py", (ALONE, "tests/storage/test_maps.py")),
    Target(
        "app/services/builds/place_scan.py",
        (ALONE, f"{SERVICES}/test_place_scan.py"),
        (
            "beside_map",
            "_unregistered",
            "_given",
            "_registered",
            "contradicts",
            "_is_near",
            "replacement_warnings",
            "_listed",
        ),
    ),
    Target(
        "app/services/builds/run_build.py",
        (
            f"{SERVICES}/builds/test_build_steps.py",
            f"{SERVICES}/builds/test_published_map.py",
            f"{SERVICES}/test_run_build.py",
        ),
    ),
)
