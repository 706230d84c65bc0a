"""The documentation holds: links lead somewhere, commands and paths exist, figures say where they come from."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer.main

from app.cli import app

ROOT = Path(__file__).parents[1]
GUIDES = sorted((ROOT / "docs").glob("*.md"))
FIGURES = [path for path in sorted((ROOT / "docs" / "figures").glob("*.md")) if path.name != "README.md"]
PAGES = [ROOT / "README.md", *GUIDES, *FIGURES, ROOT / "docs" / "figures" / "README.md"]
READMES = [ROOT / "app" / "geometry" / "README.md", ROOT / "training" / "README.md"]
# Written by scripts of their own, not by commands of `roomfix`.
NOT_COMMANDS = {"slow-tests", "mutants"}
# Pages that are not called as their command.
PAGE_OF = {"unseen": "evaluate-rooms", "bursts": "evaluate"}
HEADER = ("command", "commit", "date", "machine")

LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
FENCE = re.compile(r"^```\w*\n(.*?)^```", re.DOTALL | re.MULTILINE)
SPAN = re.compile(r"`([^`\n]+)`")
TREE = re.compile(r"`((?:app|bench|docs|migrations|tests|training)/[\w./-]*)`")
NAMED_PAGE = re.compile(r"\bdocs/[\w/-]+\.md\b")


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def prose(path: Path) -> str:
    """Return a page without its blocks of code."""
    return FENCE.sub("", path.read_text(encoding="utf-8"))


@cache
def anchors(path: Path) -> frozenset[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    found: list[str] = []
    for heading in re.findall(r"^#+ (.*)$", prose(path), re.MULTILINE):
        slug = re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")
        found.append(slug if slug not in found else f"{slug}-{found.count(slug)}")
    return frozenset(found)


@pytest.mark.parametrize("path", [*PAGES, *READMES], ids=name_of)
def test_links_lead_somewhere(path: Path) -> None:
    broken = []
    for target in LINK.findall(prose(path)):
        if target.startswith(("http://", "https://")):
            continue
        file, _, anchor = target.partition("#")
        page = (path.parent / file).resolve() if file else path
        if not page.exists() or (anchor and anchor not in anchors(page)):
            broken.append(target)
    assert not broken


@pytest.mark.parametrize("path", [*PAGES, *READMES], ids=name_of)
def test_paths_of_the_repository_exist(path: Path) -> None:
    assert not [named for named in TREE.findall(prose(path)) if not (ROOT / named).exists()]


def test_pages_that_the_code_names_exist() -> None:
    sources = [path for name in ("app", "bench", "tests") for path in (ROOT / name).rglob("*.py")]
    missing = {
        f"{name_of(path)}: {page}"
        for path in sources
        for page in NAMED_PAGE.findall(path.read_text(encoding="utf-8"))
        if not (ROOT / page).exists() and path != Path(__file__)
    }
    # Pages of scripts that run for long may be missing.
    assert not {text for text in missing if Path(text).stem not in NOT_COMMANDS}


def test_every_page_can_be_found_from_the_readme() -> None:
    reached, open_pages = set[Path](), [ROOT / "README.md"]
    while open_pages:
        page = open_pages.pop()
        if page in reached:
            continue
        reached.add(page)
        files = (target.partition("#")[0] for target in LINK.findall(prose(page)))
        pages = ((page.parent / file).resolve() for file in files if file.endswith(".md"))
        open_pages += [each for each in pages if each.is_file()]
    assert {page for page in PAGES if page.stem not in NOT_COMMANDS} <= reached


@cache
def command_group() -> Any:
    return typer.main.get_command(app)


def uses_of_roomfix(text: str) -> Iterator[list[str]]:
    """Yield the words after `roomfix` of each command in a page's code, blocks and spans."""
    blocks = [block.replace("\\\n", " ") for block in FENCE.findall(text)]
    lines = [line for block in blocks for line in block.splitlines()]
    for code in [*lines, *SPAN.findall(FENCE.sub("", text))]:
        found = re.search(r"(?:^|[\s/])roomfix (?=[a-z])(.*)", code)
        if found and not code.lstrip().startswith("#"):
            yield shlex.split(found.group(1), comments=True)


def problems_of(words: list[str]) -> list[str]:
    """Return what is wrong with a use of the command line: the command's name, or options that it doesn't have."""
    group = command_group()
    command = group.get_command(None, words[0])
    if isinstance(command, typer.main.TyperGroup) and len(words) > 1:
        command = command.get_command(None, words[1])
    if command is None:
        return [f"roomfix {words[0]}"]
    known = {"--help", *(name for each in command.params for name in [*each.opts, *each.secondary_opts])}
    given = [word.partition("=")[0] for word in words[1:] if word.startswith("--")]
    return [f"roomfix {words[0]} {option}" for option in given if option not in known]


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_commands_and_their_options_exist(path: Path) -> None:
    uses = list(uses_of_roomfix(path.read_text(encoding="utf-8")))
    assert not [problem for words in uses for problem in problems_of(words)]


def test_options_that_pages_explain_in_words_exist() -> None:
    group = command_group()
    known = {"--help"}
    for name in group.list_commands(None):
        command = group.get_command(None, name)
        below = [command.get_command(None, each) for each in getattr(command, "commands", ())]
        known |= {
            option
            for one in [command, *below]
            for each in one.params
            for option in [*each.opts, *each.secondary_opts]
        }
    # Of pytest.
    known.add("--junit-xml")
    named = {
        (name_of(path), word.partition("=")[0])
        for path in PAGES
        for span in SPAN.findall(prose(path))
        for word in span.split()
        if re.match(r"--[a-z]", word)
    }
    assert len(named) > 20
    assert not {(page, option) for page, option in named if option not in known}


def test_the_checks_see_what_they_should() -> None:
    block = "```sh\nroomfix nonsense\n.venv/bin/roomfix demo \\\n  --whole # x\n```\n"
    text = f"Say `roomfix track DATA --nothing`.\n{block}"
    uses = list(uses_of_roomfix(text))
    assert uses == [["nonsense"], ["demo", "--whole"], ["track", "DATA", "--nothing"]]
    assert [problem for words in uses for problem in problems_of(words)] == [
        "roomfix nonsense",
        "roomfix track --nothing",
    ]
    assert len([path for path in PAGES if list(uses_of_roomfix(path.read_text(encoding="utf-8")))]) > 10


def header_of(text: str) -> dict[str, str]:
    """Return the lines `- name: value` of a text that are about its origin."""
    return {
        name: value for name, value in re.findall(r"^- (\w+): (.+)$", text, re.MULTILINE) if name in HEADER
    }


@pytest.mark.parametrize("path", FIGURES, ids=name_of)
def test_figures_say_where_they_come_from(path: Path) -> None:
    if path.stem not in NOT_COMMANDS:
        assert command_group().get_command(None, PAGE_OF.get(path.stem, path.stem)) is not None
    head, *sections = re.split(r"^## ", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert sections
    # A header above the first section is that of the whole page.
    for section in [head] if header_of(head) else sections:
        title, header = section.partition("\n")[0], header_of(section)
        assert set(header) == set(HEADER), f"{path.name}: {title}"
        assert header["command"].startswith(("`roomfix ", "`python -m ")), title
        assert re.match(r"`[0-9a-f]{7,40}`", header["commit"]), title
        assert re.fullmatch(r"\d{4}-\d\d-\d\d", header["date"]), title


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_tables_have_as_many_cells_in_each_row(path: Path) -> None:
    for table in re.findall(r"(?:^\|.*\n)+", prose(path) + "\n", re.MULTILINE):
        lines = table.splitlines()
        counts = {len(re.findall(r"(?<!\\)\|", line)) for line in lines}
        assert len(counts) == 1, lines[0]
