"""The README's table of equations: complete, importable, and backed by each function's own words."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

import pytest

README = (Path(__file__).parents[2] / "app" / "geometry" / "README.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| ([ABC] [\d.\-]+) \| [^|]+ \| `([\w.]+):([\w.]+)` \|$", re.MULTILINE)
# "A eq. 5-6, 9, 10" or "C eq. 4.2.3 and 4.2.5-4.2.6": a paper, then numbers and ranges.
MENTION = re.compile(r"([ABC])(?: \d\.\d,)? eq\. (\d+(?:\.\d+)*(?:(?:-|, | and )\d+(?:\.\d+)*)*)")


def expanded(numbers: str) -> set[str]:
    """Return the single equation numbers of a list such as `5-6, 9` or `4.2.5-4.2.6`."""
    single = set()
    for part in re.split(r", | and ", numbers):
        first, _, last = part.partition("-")
        prefix, _, start = first.rpartition(".")
        end = (last or first).rpartition(".")[2]
        single |= {f"{prefix}.{n}" if prefix else str(n) for n in range(int(start), int(end) + 1)}
    return single


def mentioned(text: str, paper: str) -> set[str]:
    flat = re.sub(r"\s+", " ", text)
    return set().union(*(expanded(numbers) for name, numbers in MENTION.findall(flat) if name == paper))


def resolve(module_name: str, path: str) -> tuple[Any, Any]:
    module = importlib.import_module(module_name)
    target: Any = module
    for name in path.split("."):
        target = getattr(target, name)
    return module, target


ROWS = ROW.findall(README)


@pytest.mark.parametrize(("equation", "module_name", "path"), ROWS, ids=[f"{e} {p}" for e, _, p in ROWS])
def test_function_exists_and_says_which_equation_it_is(equation, module_name, path):
    module, target = resolve(module_name, path)
    assert callable(target)
    paper, numbers = equation.split()
    said = mentioned(f"{target.__doc__ or ''}\n{module.__doc__ or ''}", paper)
    assert expanded(numbers) <= said, f"{module_name}:{path} mentions {sorted(said)} of paper {paper}"


def test_every_equation_of_the_three_papers_has_a_row():
    sections = {"4.2": 7, "4.3": 9, "5.1": 3}
    wanted = {f"A {n}" for n in range(1, 12)} | {f"B {n}" for n in range(1, 17)}
    wanted |= {f"C {section}.{n}" for section, last in sections.items() for n in range(1, last + 1)}
    listed = {f"{e.split()[0]} {number}" for e, _, _ in ROWS for number in expanded(e.split()[1])}
    missing = set()
    if line := re.search(r"^Not yet implemented: (.+)\.$", README, re.MULTILINE):
        missing = set(line[1].split(", "))
    assert listed | missing == wanted
    assert not listed & missing


def test_no_row_of_the_table_escapes_the_check():
    table = README.split("## Equation to function")[1].split("##")[0]
    rows = [line for line in table.splitlines() if line.startswith("| ")][2:]
    assert len(rows) == len(ROWS) > 30


def test_ranges_and_lists_are_read_as_written():
    text = "First (A eq. 5-6, 9). Then C eq.\n    4.2.3 and 4.2.5-4.2.6, and (A 2.1, eq. 1-3)."
    assert mentioned(text, "A") == {"5", "6", "9", "1", "2", "3"}
    assert mentioned(text, "C") == {"4.2.3", "4.2.5", "4.2.6"}
    assert mentioned(text, "B") == set()
