"""The pages over HTTP: what they serve, under which headers, and that nothing in them comes from elsewhere."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import get_args
from urllib.parse import urljoin

import pytest
from fastapi.testclient import TestClient

from app.engine.query.verification import Reason
from app.jobs.runner import NoRunner
from app.main import create_app
from app.settings import Settings
from app.web.pages import STATIC

STATIC_FILES = sorted(path.relative_to(STATIC).as_posix() for path in STATIC.rglob("*") if path.is_file())
SCRIPTS = sorted((STATIC / "js").rglob("*.js"))
# Folders of sentences; pages for phones say those of `go`, and their own.
CATALOGUES = ("go", "record")
LANGUAGES = sorted((STATIC / "languages").rglob("*.json"))
PAGES = sorted(STATIC.glob("*.html"))


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    settings = Settings(data_dir=tmp_path_factory.mktemp("data"), open=True, run_worker=False)
    with TestClient(create_app(settings, NoRunner()), base_url="http://127.0.0.1") as client:
        yield client


@pytest.mark.parametrize(
    "path",
    ["/", "/docs", "/go/any", "/record/any", "/assets/js/main.js", "/docs/assets/swagger-ui-bundle.js"],
)
def test_pages_and_assets_carry_the_security_headers(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 200
    policy = dict(part.split(" ", 1) for part in answer.headers["Content-Security-Policy"].split("; "))
    assert policy["default-src"] == "'self'"
    assert policy["frame-ancestors"] == "'none'"
    assert not any("unsafe" in sources or "http" in sources for sources in policy.values())
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert answer.headers["Referrer-Policy"] == "no-referrer"
    assert answer.headers["Cache-Control"] == "no-cache"


def test_a_missing_asset_is_a_problem_and_the_folder_cannot_be_left(client: TestClient) -> None:
    for path in ("/assets/none.js", "/assets/../pages.py", "/assets/%2e%2e/pages.py", "/docs/assets/none.js"):
        answer = client.get(path)
        assert answer.status_code == 404, path
        assert answer.headers["Content-Type"] == "application/problem+json"


@pytest.mark.parametrize("name", STATIC_FILES)
def test_every_static_file_is_served_with_its_type(client: TestClient, name: str) -> None:
    types = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
    types[".json"] = "application/json"
    answer = client.get(f"/assets/{name}")
    assert answer.status_code == 200
    assert answer.headers["Content-Type"].startswith(types[Path(name).suffix])


@pytest.mark.parametrize(
    ("page", "address"),
    [
        ("index.html", "/"),
        ("docs.html", "/docs"),
        ("go.html", "/go/museum"),
        ("record.html", "/record/museum"),
    ],
)
def test_what_a_page_refers_to_is_there(client: TestClient, page: str, address: str) -> None:
    html = client.get(address).text
    assert html == (STATIC / page).read_text(encoding="utf-8")
    references = re.findall(r'(?:src|href)="([^"#]+)"', html)
    assert len(references) >= 4
    for reference in references:
        # Relative, so that the pages also work below the path prefix of a proxy.
        assert not reference.startswith("/")
        assert client.get(urljoin(address, reference)).status_code == 200, reference


def test_modules_import_only_modules_that_are_there() -> None:
    for script in SCRIPTS:
        for imported in re.findall(r'from "([^"]+)"', script.read_text(encoding="utf-8")):
            assert (script.parent / imported).is_file(), f"{script.name} imports {imported}"


def modules_of(page: Path) -> set[Path]:
    """Return the modules that a page loads, with all that they import."""
    found: set[Path] = set()
    html = page.read_text(encoding="utf-8")
    waiting = [(STATIC / path).resolve() for path in re.findall(r'assets/(js/[^"]+)" type="module"', html)]
    while waiting:
        script = waiting.pop()
        if script not in found:
            found.add(script)
            imported = re.findall(r'from "([^"]+)"', script.read_text(encoding="utf-8"))
            waiting += [(script.parent / name).resolve() for name in imported]
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_ids_that_scripts_look_up_are_in_the_page(page: Path) -> None:
    ids = re.findall(r' id="([^"]+)"', page.read_text(encoding="utf-8"))
    assert len(ids) == len(set(ids))
    scripts = modules_of(page)
    assert scripts
    for script in scripts:
        for wanted in re.findall(r'byId\("([^"]+)"\)', script.read_text(encoding="utf-8")):
            assert wanted in ids, f"{script.name} looks for #{wanted}"


def test_every_script_belongs_to_a_page() -> None:
    classic = {STATIC / "js" / "theme.js"}
    assert set(SCRIPTS) == classic.union(*(modules_of(page) for page in PAGES))


@pytest.mark.parametrize("folder", CATALOGUES)
def test_every_language_has_the_same_sentences_with_the_same_names(client: TestClient, folder: str) -> None:
    files = [path for path in LANGUAGES if path.parent.name == folder]
    assert client.get("/assets/languages").json() == [path.stem for path in files]
    catalogues = [json.loads(path.read_text(encoding="utf-8")) for path in files]
    names = [
        {key: sorted(re.findall(r"\{(\w+)\}", sentence)) for key, sentence in catalogue.items()}
        for catalogue in catalogues
    ]
    assert len(names) > 1
    assert all(each == names[0] for each in names)


@pytest.mark.parametrize("folder", CATALOGUES)
def test_every_sentence_that_a_phones_page_says_is_in_the_catalogues(folder: str) -> None:
    catalogue: dict[str, str] = {}
    for path in LANGUAGES:
        if path.parent.name in ("go", folder):
            catalogue |= json.loads(path.read_text(encoding="utf-8"))
    said = {
        key
        for script in (STATIC / "js" / folder).glob("*.js")
        for key in re.findall(r'\b(?:say|translated)\("([^"]+)"', script.read_text(encoding="utf-8"))
    }
    assert len(said) > 20
    assert said <= set(catalogue)


def test_every_reason_for_no_place_has_words_on_every_page() -> None:
    words = (STATIC / "js" / "words.js").read_text(encoding="utf-8")
    catalogues = [
        json.loads(path.read_text(encoding="utf-8")) for path in LANGUAGES if path.parent.name == "go"
    ]
    for reason in get_args(Reason):
        assert f"  {reason}: [" in words, reason
        said = [catalogue[f"lost.{reason}"] for catalogue in catalogues]
        assert len(set(said)) == len(catalogues), reason


def test_every_field_has_a_label() -> None:
    html = (STATIC / "index.html").read_text(encoding="utf-8")
    labelled = set(re.findall(r'<label[^>]* for="([^"]+)"', html))
    wrapped = "".join(re.findall(r"<label\b.*?</label>", html, re.S))
    for field in re.findall(r"<(?:input|select|textarea)\b[^>]*>", html):
        name = re.search(r' id="([^"]+)"', field)
        assert field in wrapped or (name and name[1] in labelled), field


def test_no_markup_from_data_no_inline_code_no_other_hosts() -> None:
    for path in [*PAGES, *SCRIPTS, *(STATIC / "css").glob("*.css")]:
        text = path.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
        assert not re.search(
            r"https?://|(?:src|href)=\"//|@import|url\(", text.replace('fill: "url(#', "")
        ), path
        if path.suffix == ".js":
            assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(", text), (
                path
            )
        if path.suffix == ".html":
            assert not re.search(r"\son[a-z]+=|\sstyle=|<style|<script(?![^>]* src=)|javascript:", text), path


def test_swagger_ui_is_the_release_that_reads_the_servers_openapi(client: TestClient) -> None:
    assert client.get("/openapi.json").json()["openapi"].startswith("3.1")
    # OpenAPI 3.1 is read from Swagger UI 5 on; 4 shows an error instead.
    assert re.search(r'"5\.\d+\.\d+"', client.get("/docs/assets/swagger-ui-bundle.js").text)
    assert client.get("/redoc").status_code == 404


def test_pages_are_not_part_of_the_api(client: TestClient) -> None:
    paths = client.get("/openapi.json").json()["paths"]
    assert "/" not in paths
    assert "/docs" not in paths


def test_every_stage_of_a_build_has_words() -> None:
    stages = {"start", "upload"}
    for path in (STATIC.parents[1] / "engine").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if name in ("map_in_order", "report"):
                texts = [each.value for each in node.args if isinstance(each, ast.Constant)]
                stages |= {text for text in texts if isinstance(text, str)}
    assert {"distinguish", "describe", "examine"} <= stages
    words = (STATIC / "js" / "words.js").read_text(encoding="utf-8")
    listed = words[words.index("const BUILD_STAGES = {") :].partition("};")[0]
    assert stages <= set(re.findall(r'^  "?([\w ]+)"?: ', listed, re.MULTILINE))
