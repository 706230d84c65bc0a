"""The TypeScript client: compiles strictly, its README's samples run as printed, its types match the server's."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.clients.conftest import Site
from tests.clients.schemas import schemas

FOLDER = Path(__file__).parents[2] / "clients" / "typescript"
README = (FOLDER / "README.md").read_text(encoding="utf-8")
SAMPLES = re.findall(r"^(\S[^\n]*):\n```ts\n(.*?)^```", README, re.DOTALL | re.MULTILINE)
PRINTED = {
    "Locate": r"true 0 ", "Make": r"museum.* until 20", "Content": r"content {",
    "Build": r"tum \d+ frames, \w+[\s\S]*version \d+",
    "Stream": r"tracking 1\n", "Push": r"\d+\n",
}  # fmt: skip
# A folder in which `npm install typescript ws @types/ws` was run.
MODULES = Path(os.environ.get("ROOMFIX_TEST_NODE_MODULES", FOLDER / "node_modules"))
TSC = MODULES / ".bin" / "tsc"
needs_compiler = pytest.mark.skipif(
    not TSC.exists() or shutil.which("node") is None, reason="typescript is not installed: npm install"
)
HEAD = """
import {{ readFileSync }} from "node:fs";
import WebSocketOfNode from "ws";
const [URL_, KEY, ADMIN_KEY, ANCHOR_KEY, CAMERA] = {values} as [string, string, string, string, string];
const photo = new Blob([readFileSync("photo.jpg")]), scan = new Blob([readFileSync("scan.zip")]);
const WebSocketClass = WebSocketOfNode as unknown as typeof WebSocket;
void [URL_, KEY, ADMIN_KEY, ANCHOR_KEY, CAMERA, photo, scan, WebSocketClass];
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project that has the compiled client and the samples' other packages."""
    folder = tmp_path_factory.mktemp("typescript")
    own = folder / "node_modules" / "roomfix-client"
    shutil.copytree(FOLDER, own, ignore=shutil.ignore_patterns("node_modules", "dist"))
    for name in ("ws", "@types"):
        (folder / "node_modules" / name).symlink_to(MODULES / name)
    compiled(own, "-p", ".")
    (folder / "package.json").write_text('{"type": "module"}', encoding="utf-8")
    return folder


def compiled(folder: Path, *options: str) -> None:
    result = subprocess.run([TSC, *options], cwd=folder, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout


@needs_compiler
@pytest.mark.parametrize(("title", "code"), SAMPLES, ids=[title.split()[0] for title, _ in SAMPLES])
def test_a_sample_of_the_readme_compiles_and_runs_as_printed(
    site: Site, package: Path, title: str, code: str
) -> None:
    name = title.split(maxsplit=1)[0]
    values = [site.names[each] for each in ("URL", "KEY", "ADMIN_KEY", "ANCHOR_KEY", "CAMERA")]
    file = package / f"{name}.ts"
    file.write_text(HEAD.format(values=values) + code, encoding="utf-8")
    for data in ("photo.jpg", "scan.zip"):
        shutil.copy(site.folder / data, package / data)
    modules = ("--module", "NodeNext", "--target", "ES2022", "--skipLibCheck", "--types", "node")
    compiled(package, "--strict", *modules, file.name)
    ran = subprocess.run(
        ["node", f"{name}.js"], cwd=package, capture_output=True, text=True, check=False, timeout=120
    )
    assert ran.returncode == 0, ran.stderr
    assert re.search(PRINTED[name], ran.stdout), ran.stdout


def test_every_kind_of_use_has_a_sample() -> None:
    assert [title.split()[0] for title, _ in SAMPLES] == list(PRINTED)


def test_types_have_the_fields_that_the_server_describes() -> None:
    text = (FOLDER / "src" / "answers.ts").read_text(encoding="utf-8")
    found = re.findall(r"export interface (\w+)(?: extends (\w+))? {(.*?)\n}", text, re.DOTALL)
    own = {name: set(re.findall(r"^  (\w+)\??:", body, re.MULTILINE)) for name, _, body in found}
    assert len(found) > 12
    for name, base, _ in found:
        described = set(schemas()[name]["properties"])
        # The number of a frame belongs to streams alone, the list of fields to invalid requests.
        assert own[name] | own.get(base, set()) == described - {"fields"} | ({"received"} & own[name]), name
