"""Generators of clients understand the OpenAPI document: no warning, no model left out, no answer without a type."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from app.api.bodies.report import OpenBody
from app.api.openapi import openapi_document
from app.jobs.runner import NoRunner
from app.main import create_app
from app.settings import Settings

CLIENTS = Path(__file__).parents[2] / "clients"
MODULES = Path(os.environ.get("ROOMFIX_TEST_NODE_MODULES", CLIENTS / "typescript" / "node_modules"))
# A folder in which `pip install --target` has put openapi-python-client, which wants other versions than the server.
GENERATOR = Path(os.environ.get("ROOMFIX_TEST_PYTHON_GENERATOR", CLIENTS / "python" / ".generator"))

IMPORT_ALL = """
import importlib, pathlib
found = [path for path in pathlib.Path("client/api").rglob("*.py") if path.name != "__init__.py"]
assert len(found) > 40
for path in found:
    importlib.import_module(".".join(path.with_suffix("").parts))
"""


def needs(path: Path, package: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(not path.exists(), reason=f"{package} is not installed; .ci/run says how")


def run(folder: Path, *command: str | Path, **environment: str) -> str:
    ran = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, env={**os.environ, **environment}
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout + ran.stderr


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return openapi_document(create_app(Settings(_env_file=None, open=True), NoRunner()))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, document: dict[str, Any]) -> Path:
    folder = tmp_path_factory.mktemp("generated")
    (folder / "openapi.json").write_text(json.dumps(document), encoding="utf-8")
    return folder


@needs(MODULES / ".bin" / "redocly", "@redocly/cli")
def test_redocly_finds_nothing_to_warn_of(folder: Path) -> None:
    found = run(
        folder, MODULES / ".bin" / "redocly", "lint", "openapi.json", "--format", "json",
        REDOCLY_TELEMETRY="off", REDOCLY_SUPPRESS_UPDATE_NOTICE="true",
    )  # fmt: skip
    report = json.loads(found[found.index("{") : found.rindex("}") + 1])
    assert report["problems"] == []
    assert report["totals"] == {"errors": 0, "warnings": 0, "ignored": 0}


@needs(MODULES / ".bin" / "openapi-typescript", "openapi-typescript")
def test_typescript_types_compile_strictly_and_none_is_unknown(
    folder: Path, document: dict[str, Any]
) -> None:
    run(folder, MODULES / ".bin" / "openapi-typescript", "openapi.json", "-o", "api.ts")
    run(folder, MODULES / ".bin" / "tsc", "--strict", "--noEmit", "--target", "ES2022", "api.ts")
    text = (folder / "api.ts").read_text(encoding="utf-8")
    schemas = text[text.index("    schemas: {") : text.index("    responses: never")]
    named = re.findall(r"^        (\w+): ", schemas, re.MULTILINE)
    assert set(document["components"]["schemas"]) <= set(named)
    blocks = re.findall(r"^        (\w+): \{\n(.*?)^        \};", schemas, re.DOTALL | re.MULTILINE)
    loose = {name for name, body in blocks if re.search(r": unknown;| any;", body)}
    # GeoJSON properties are the client's own; what builds report grows.
    assert "BuildReport" in loose
    reports = {model.__name__ for model in OpenBody.__subclasses__()}
    assert loose <= {"FeatureProperties", "PlacedProperties"} | reports
    # In the operations only headers are open.
    operations = text[text.index("export interface operations") :]
    rest = operations.replace("[name: string]: unknown;", "")
    assert not re.search(r"\bunknown;|\bany;", rest)


@needs(GENERATOR, "openapi-python-client")
def test_openapi_python_client_leaves_nothing_out(folder: Path, document: dict[str, Any]) -> None:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    printed = run(
        folder, sys.executable, "-m", "openapi_python_client", "generate", "--path", "openapi.json",
        "--config", CLIENTS / "openapi-python-client.yaml", "--output-path", "client", "--meta", "none",
        PYTHONPATH=str(GENERATOR), PATH=path,
    )  # fmt: skip
    assert "warning" not in printed.lower(), printed
    exported = ast.parse((folder / "client" / "models" / "__init__.py").read_text(encoding="utf-8"))
    models = {
        alias.name for node in exported.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    # Positions of GeoJSON are plain lists.
    schemas = document["components"]["schemas"].items()
    expected = {name.lower() for name, schema in schemas if schema["type"] == "object"}
    assert len(expected) > 80
    assert expected <= {name.lower() for name in models}
    modules = [path for path in (folder / "client" / "api").rglob("*.py") if path.name != "__init__.py"]
    assert len(modules) == sum(len(calls) for calls in document["paths"].values())
    loose = {
        model.stem
        for model in (folder / "client" / "models").glob("*.py")
        if re.search(r"^    \w+: (Any\b|.*\bAny \|)", model.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert loose == set()
    for module in modules:
        answers = re.findall(r"(?<!_)response_(2\d\d) = (.*)", module.read_text(encoding="utf-8"))
        assert answers, module
        for status, value in answers:
            # The protocol of uploads answers with headers alone.
            is_empty = status == "204" or module.name in ("create_upload.py", "get_upload_offset.py")
            assert is_empty or not value.startswith(("cast(Any", "response.json()")), module
    run(folder, sys.executable, "-c", IMPORT_ALL, PYTHONPATH=str(GENERATOR))
    shutil.rmtree(folder / "client")
