"""The clients for Swift, Kotlin and Unity: they parse or compile, and name nothing that the server doesn't have."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
import tree_sitter_kotlin
import tree_sitter_swift
from tree_sitter import Language, Node, Parser

from app.api.openapi import openapi_document
from app.api.requests.axes import AxesName
from app.jobs.runner import NoRunner
from app.main import create_app
from app.settings import Settings

CLIENTS = Path(__file__).parents[2] / "clients"
STUBS = Path(__file__).with_name("unity_stubs.cs")
SWIFT = sorted((CLIENTS / "swift").rglob("*.swift"))
KOTLIN = sorted((CLIENTS / "kotlin").rglob("*.kt*"))
UNITY = sorted((CLIENTS / "unity").rglob("*.cs"))
# Client's name -> the server's name of the same.
SCHEMAS = {
    "RoomfixError": "Problem", "RoomfixPose": "Pose", "Rotation": "Quaternion", "error": "Problem",
    "locateResult": "LocateResult", "pose": "Pose", "plan": "Plan",
}  # fmt: skip


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return openapi_document(create_app(Settings(_env_file=None, open=True), NoRunner()))


def fields_of(document: dict[str, Any], name: str) -> set[str]:
    return set(document["components"]["schemas"][SCHEMAS.get(name, name)]["properties"])


def text_of(files: list[Path]) -> str:
    assert files
    return "\n".join(path.read_text(encoding="utf-8") for path in files)


def faults(node: Node) -> Iterator[Node]:
    """Yield the places of a syntax tree that could not be parsed."""
    if node.is_error or node.is_missing:
        yield node
    for child in node.children:
        yield from faults(child)


@pytest.mark.parametrize("path", [*SWIFT, *KOTLIN], ids=lambda path: path.name)
def test_a_file_parses(path: Path) -> None:
    grammar = tree_sitter_swift if path.suffix == ".swift" else tree_sitter_kotlin
    parser = Parser(Language(grammar.language()))
    tree = parser.parse(path.read_bytes())
    assert not [(node.start_point, node.text) for node in faults(tree.root_node)]
    before, _, after = path.read_bytes().rpartition(b")")
    assert list(faults(parser.parse(before + after).root_node))


@pytest.mark.skipif(shutil.which("mcs") is None, reason="mcs is not installed: apt-get install mono-mcs")
def test_the_unity_client_and_its_sample_compile(tmp_path: Path) -> None:
    assembly = tmp_path / "client.dll"
    command = ["mcs", "-target:library", "-langversion:7", "-warnaserror", "-nowarn:649", f"-out:{assembly}"]
    ran = subprocess.run([*command, STUBS, *UNITY], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert assembly.is_file()


@pytest.mark.parametrize(
    ("files", "pattern"),
    [
        (SWIFT, r'\(?"(\w+)", (?:axes\.rawValue|venue|floor|camera\.map|"\\|String)|name=\\"([a-z_]+)\\";'),
        (KOTLIN, r'fields\["(\w+)"\]|mutableMapOf\("(\w+)" to|name=\\"([a-z_]+)\\";'),
        (UNITY, r'MultipartForm(?:Data|File)Section\("(\w+)"'),
    ],
    ids=["swift", "kotlin", "unity"],
)
def test_what_is_sent_are_fields_of_locate(document: dict[str, Any], files: list[Path], pattern: str) -> None:
    text = text_of(files)
    sent = {
        name
        for groups in re.findall(pattern, text)
        for name in ([groups] if isinstance(groups, str) else groups)
    }
    assert sent - {""} == {"image", "venue", "floor", "camera", "gravity", "axes", "device_pose"}
    assert sent - {""} <= fields_of(document, "LocateImageForm")
    routes = set(re.findall(r'"(?:[^"\s]*[)a-z])?(/[a-z]+)"', text.replace("image/jpeg", "")))
    assert routes == {"/locate"}
    assert routes <= set(document["paths"])


def test_swift_reads_fields_that_the_server_describes(document: dict[str, Any]) -> None:
    text = text_of(SWIFT)
    found = re.findall(r"public struct (\w+): [^{]*{(.*?)\n}", text, re.DOTALL)
    keys = {name: set(re.findall(r'case \w+ = "(\w+)"', body)) for name, body in found}
    assert set(keys) >= {"Plan", "Accuracy", "LocateResult", "RoomfixError"}
    for name, own in keys.items():
        assert own <= fields_of(document, name), name
    for name in ("Position", "Quaternion", "Pose"):
        body = dict(found)[name]
        declared = {each for line in re.findall(r"public let ([\w, ]+):", body) for each in line.split(", ")}
        assert declared == fields_of(document, name)
    cases = re.search(r"enum Axes: String {\s+case ([\w, ]+)", text)
    assert cases is not None
    assert set(cases[1].split(", ")) == set(get_args(AxesName))


def test_kotlin_reads_fields_that_the_server_describes(document: dict[str, Any]) -> None:
    text = text_of(KOTLIN)
    found = dict(re.findall(r"fun (\w+)Of\(json: JSONObject\)(.*?)\n\n", text, re.DOTALL))
    found["error"] = text[text.index("fun errorOf(status") :]
    assert set(found) == {"locateResult", "pose", "plan", "error"}
    parts = {"x", "y", "z", "w", "position_m"}
    for name, body in found.items():
        own = set(re.findall(r'(?:get\w+|opt\w+|text)\("(\w+)"\)', body))
        assert own, name
        assert own - parts <= fields_of(document, name), name
    assert "position_m" in fields_of(document, "Accuracy")
    assert set(re.findall(r'axes(?:: String)? = "(\w+)"', text)) == {"arcore"} <= set(get_args(AxesName))


def test_unity_reads_fields_that_the_server_describes(document: dict[str, Any]) -> None:
    text = text_of(UNITY)
    found = re.findall(r"\[Serializable\]\s+public (?:struct|class) (\w+)\s+{(.*?)\n    }", text, re.DOTALL)
    assert {"Position", "Rotation", "RoomfixPose", "Plan", "LocateResult", "Problem"} <= {
        name for name, _ in found
    }
    for name, body in found:
        lines = re.findall(r"^        public [\w\[\]]+ ([\w, ]+);", body, re.MULTILINE)
        own = {each for line in lines for each in line.split(", ")}
        assert own, name
        assert own <= fields_of(document, name), name
    assert set(re.findall(r'Axes = "(\w+)"', text)) == {"unity"} <= set(get_args(AxesName))


@pytest.mark.parametrize("client", ["swift", "kotlin", "unity"])
def test_a_sample_uses_what_places_content(client: str) -> None:
    files = {"swift": SWIFT, "kotlin": KOTLIN, "unity": UNITY}[client]
    sample = text_of([path for path in files if path.stem in ("ContentPlacer", "PlaceContent")]).lower()
    for word in ("gravity", "devicepose", "session"):
        assert word in sample
    assert re.search("sessionfromworld|session_from_world", sample)
    assert re.search("intrinsics", sample)
