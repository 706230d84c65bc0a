"""The house of docs/architecture.md as rules: who imports whom, how full a folder is, where a library appears."""

from __future__ import annotations

import sys
from collections import Counter

import pytest

from tests.source_tree import circles, modules_of, targets

# From the ground up; a layer imports what is below it, and itself. Layers in one tuple don't know each other.
LAYERS: tuple[tuple[str, ...], ...] = (
    ("build_kinds", "errors", "limits", "logs", "lru", "models", "web"),
    ("settings", "geometry"),
    ("vision", "importers"),
    ("engine",),
    ("storage",),
    ("services",),
    ("jobs", "api"),
    ("main",),
    ("commands", "cli"),
)
# What a layer may not import although it is below.
NOT_FOR = {
    "geometry": {"settings"},
    "vision": {"settings"},
    "importers": {"settings"},
    "engine": {"settings", "web"},
    "storage": {"settings", "web"},
}
# What it may import beside it: routes wake the runner that main gave them, by its protocol alone; the command
# line names its commands; importers open image files by the rules that queries are opened by; pages have limits.
ALSO = {
    "api": {"app.jobs.runner"},
    "cli": {"app.commands"},
    "importers": {"app.vision.image_files"},
    "web": {"app.limits"},
}
# Rooms of the engine -> the other rooms that they stand on.
ROOMS = {
    "floors": set[str](),
    "maps": {"floors"},
    "query": {"floors", "maps"},
    "mapping": {"floors", "maps", "query"},
    "anchors": {"floors", "maps", "query"},
    "tracking": {"floors", "maps", "query", "mapping", "anchors"},
    "navigation": {"floors"},
}
# Modules of the engine that every room may use.
SHARED = {"app.engine.progress", "app.engine.stage_timer"}
# Library -> the only parts of app that may use it.
ONLY_IN: dict[str, set[str]] = {
    "fastapi": {"main", "api", "web"},
    "starlette": {"main", "api", "web"},
    "sse_starlette": {"api"},
    "pydantic": {"api", "settings", "services"},
    "pydantic_settings": {"settings"},
    "structlog": {"logs"},
    "sqlalchemy": {"storage", "services", "api"},
    "alembic": {"storage"},
    "obstore": {"storage"},
    "onnxruntime": {"vision"},
    "matplotlib": set(),
    "trimesh": set(),
    "embreex": set(),
    "torch": set(),
    "bench": set(),
}
# The engine is told what time it is; only its stage timer reads a clock, and no calendar.
CLOCKS = {"time", "datetime"}
CLOCK_USERS = {"app.engine.stage_timer"}
GEOMETRY_LIBRARIES = {"numpy", "scipy", "cv2", "poselib"}
MAX_MODULES = 20
# Equations have a room of their own each.
MAX_MODULES_IN = {"app.geometry": 30}

LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}


def layer_of(module: str) -> str:
    """Return the layer of a module: `app.api.maps` is in `api`, `app.main` is `main`."""
    return module.split(".")[1] if "." in module else ""


def may_import(layer: str, target: str) -> bool:
    """Whether a module of a layer may import a module of app."""
    other = layer_of(target)
    if other in ("", layer) or any(f"{target}.".startswith(f"{name}.") for name in ALSO.get(layer, ())):
        return True
    return LEVEL[other] < LEVEL[layer] and other not in NOT_FOR.get(layer, set())


@pytest.mark.parametrize("layer", sorted(LEVEL))
def test_a_layer_imports_only_what_is_below_it(layer: str) -> None:
    wrong = [
        (module.name, target)
        for module in modules_of("app").values()
        if layer_of(module.name) == layer
        for target in targets(module, modules_of("app"))
        if not may_import(layer, target)
    ]
    assert not wrong


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_of_the_engine_imports_only_rooms_below_it(room: str) -> None:
    wrong = [
        (module.name, target)
        for module in modules_of("app").values()
        if module.name.startswith("app.engine.") and module.name.split(".")[2] == room
        for target in targets(module, modules_of("app"))
        if target.startswith("app.engine.")
        and target not in SHARED
        and target.split(".")[2] not in {room, *ROOMS[room]}
    ]
    assert not wrong


def test_every_room_of_the_engine_has_its_rule() -> None:
    rooms = {
        ".".join(module.split(".")[:3]) for module in modules_of("app") if module.startswith("app.engine.")
    }
    assert rooms - SHARED == {f"app.engine.{room}" for room in ROOMS}


@pytest.mark.parametrize("package", ["app", "bench"])
def test_no_modules_import_each_other_around(package: str) -> None:
    modules = modules_of(package)
    assert not circles({name: targets(module, modules) for name, module in modules.items()})


@pytest.mark.parametrize("library", ONLY_IN)
def test_a_library_stays_in_its_place(library: str) -> None:
    users = {
        layer_of(module.name)
        for module in modules_of("app").values()
        if any(name.split(".")[0] == library for name in module.imports)
    }
    assert users <= ONLY_IN[library]


def test_the_engine_reads_no_clock() -> None:
    users = {
        module.name
        for module in modules_of("app").values()
        if layer_of(module.name) in ("engine", "vision", "geometry", "importers")
        and any(name in CLOCKS or name.startswith(("time.", "datetime.datetime.")) for name in module.imports)
    }
    assert users <= CLOCK_USERS


def test_geometry_needs_numbers_only() -> None:
    roots = {
        name.split(".")[0]
        for module in modules_of("app").values()
        if layer_of(module.name) == "geometry"
        for name in module.imports
    }
    assert roots - set(sys.stdlib_module_names) - {"app"} <= GEOMETRY_LIBRARIES
    assert {"numpy", "cv2"} <= roots


def test_no_folder_is_a_hall() -> None:
    modules = [
        module
        for module in {**modules_of("app"), **modules_of("bench")}.values()
        if module.path.name != "__init__.py"
    ]
    counts = Counter(module.folder for module in modules if ".tests" not in module.folder)
    assert not {
        folder: count for folder, count in counts.items() if count > MAX_MODULES_IN.get(folder, MAX_MODULES)
    }


def test_a_module_with_one_importer_lives_in_its_folder() -> None:
    """Within a layer: what one module alone uses stands beside it, or in a folder below."""
    modules = modules_of("app")
    importers: dict[str, list[str]] = {name: [] for name in modules}
    for module in modules.values():
        for target in targets(module, modules):
            importers[target].append(module.name)
    astray = {
        name: users[0]
        for name, users in importers.items()
        if len(users) == 1
        and layer_of(name) == layer_of(users[0])
        and not f"{modules[name].folder}.".startswith(f"{modules[users[0]].folder}.")
    }
    assert not astray


def test_the_checks_see_what_they_should() -> None:
    assert "fastapi.FastAPI" in modules_of("app")["app.main"].imports
    assert "app.geometry.camera" in targets(
        modules_of("app")["app.engine.query.localizer"], modules_of("app")
    )
    assert set(LEVEL) == {layer_of(name) for name in modules_of("app")} - {""}
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]
    assert not may_import("engine", "app.storage.db")
    assert not may_import("api", "app.jobs.worker")
    assert may_import("api", "app.jobs.runner")
