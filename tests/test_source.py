"""What keeps the source readable: short files, short functions, and text that holds on any machine."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("app", "bench", "docs", "migrations", "tests", "training")
SOURCES = [path for name in FOLDERS for path in sorted((ROOT / name).rglob("*.py"))]
MAX_FILE_LINES, MAX_FUNCTION_LINES = 400, 60
TEXT_SUFFIXES = {".css", ".html", ".js", ".mako", ".md", ".py", ".toml", ".txt", ".yaml", ".yml"}
# Put together here, so that this file is no exception: a path of one machine, and promises for later.
FORBIDDEN = re.compile(
    "|".join([r"(?<![\w.}])/wor" + r"k\b", r"\bTO" + r"DO\b", r"\bFIX" + r"ME\b", r"\bX" + r"XX\b"])
)


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def texts() -> Iterator[Path]:
    """Yield the text files of the repository."""
    yield from (path for path in ROOT.iterdir() if path.is_file() and path.suffix in TEXT_SUFFIXES)
    for name in FOLDERS:
        yield from (path for path in (ROOT / name).rglob("*") if path.suffix in TEXT_SUFFIXES)


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_files_and_functions_are_short(path: Path) -> None:
    source = path.read_text(encoding="utf-8")
    assert source.count("\n") <= MAX_FILE_LINES
    functions = (
        node
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    )
    # A migration is one list of columns, and never read together with anything else.
    limit = MAX_FILE_LINES if "versions" in path.parts else MAX_FUNCTION_LINES
    lengths = {node.name: (node.end_lineno or 0) - node.lineno + 1 for node in functions}
    assert not {name: length for name, length in lengths.items() if length > limit}


def test_no_text_belongs_to_one_machine_or_is_put_off() -> None:
    paths = list(texts())
    assert len(paths) > 100
    found = [
        f"{name_of(path)}:{number}: {line.strip()[:80]}"
        for path in paths
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if FORBIDDEN.search(line)
    ]
    assert not found


@pytest.mark.parametrize("text", ["see /wor" + "k/main", "# TO" + "DO: later", "FIX" + "ME"])
def test_the_pattern_finds_what_it_should(text: str) -> None:
    assert FORBIDDEN.search(text)


@pytest.mark.parametrize("text", ["the framework/working set", "a workbench", "todo", "https://x.y/network"])
def test_the_pattern_lets_other_words_pass(text: str) -> None:
    assert not FORBIDDEN.search(text)
