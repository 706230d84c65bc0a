"""The layers of docs/architecture.md: who may import whom, and where a library may appear."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

APP = Path(__file__).parents[1] / "app"
BELOW = {"geometry", "errors"}
CORE = {"services", "storage", "vision", "importers", "settings", *BELOW}
# Package or module of app -> the others that it may import.
MAY_IMPORT = {
    "errors": set(),
    "settings": set(),
    "models": set(),
    "geometry": {"errors"},
    "vision": BELOW,
    "importers": BELOW,
    "storage": BELOW,
    "services": CORE,
    "jobs": CORE,
    # The protocol alone: routes wake the runner that main gave them.
    "api": {*CORE, "jobs.runner"},
    "web": set(),
}
# These wire everything together.
WIRING = {"main", "cli", "commands"}
# Library -> the only parts of app that may use it.
ONLY_IN = {
    "fastapi": {"main", "api", "web"},
    "starlette": {"main", "api", "web"},
    "sse_starlette": {"api"},
    "pydantic": {"api", "settings"},
    "pydantic_settings": {"settings"},
    "alembic": {"storage"},
    "obstore": {"storage"},
    "onnxruntime": {"vision"},
    "torch": set(),
}
GEOMETRY_LIBRARIES = {"numpy", "scipy", "cv2", "poselib"}


def part_of(module: str) -> str:
    """Return the layer of a module: `app.api.maps` is in `api`, `app.main` is `main`."""
    return module.split(".")[1] if "." in module else ""


def imports() -> list[tuple[str, str]]:
    """Return pairs of a module of app and the full name of something it imports."""
    pairs = []
    for path in sorted(APP.rglob("*.py")):
        module = ".".join(path.relative_to(APP.parent).with_suffix("").parts).removesuffix(".__init__")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                pairs += [(module, alias.name) for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{module}: imports are absolute"
                assert node.module
                names = [f"{node.module}.{alias.name}" for alias in node.names]
                pairs += [(module, name) for name in names]
    return pairs


IMPORTS = imports()
PARTS = sorted({part_of(module) for module, _ in IMPORTS} - {""} - WIRING)


@pytest.mark.parametrize("part", PARTS)
def test_a_layer_imports_only_what_is_below_it(part: str) -> None:
    allowed = {f"app.{name}" for name in {*MAY_IMPORT[part], part}}
    wrong = [
        (module, name)
        for module, name in IMPORTS
        if part_of(module) == part
        and name.split(".")[0] == "app"
        and not any(name == one or name.startswith(f"{one}.") for one in allowed)
    ]
    assert not wrong


@pytest.mark.parametrize("library", ONLY_IN)
def test_a_library_stays_in_its_place(library: str) -> None:
    users = {part_of(module) for module, name in IMPORTS if name.split(".")[0] == library}
    assert users <= ONLY_IN[library]


def test_geometry_needs_numbers_only() -> None:
    roots = {name.split(".")[0] for module, name in IMPORTS if part_of(module) == "geometry"}
    assert roots - set(sys.stdlib_module_names) - {"app"} <= GEOMETRY_LIBRARIES
    assert {"numpy", "cv2"} <= roots


def test_the_check_sees_what_it_should() -> None:
    assert ("app.main", "fastapi.FastAPI") in IMPORTS
    assert ("app.services.locate_result", "app.geometry.se3.Pose") in IMPORTS
    assert {"api", "geometry", "jobs", "services", "storage", "vision"} <= set(PARTS)
