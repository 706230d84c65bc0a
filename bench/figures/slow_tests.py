"""docs/figures/slow-tests.md: the tests that take longest, from the XML file that pytest writes.

python -m pytest --junit-xml=tests.xml
python -m bench.figures.slow_tests tests.xml
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from app.errors import InvalidInputError
from bench.figures.page import FOLDER, write_figures
from bench.figures.provenance import provenance
from bench.figures.slow_test_reasons import REASONS
from bench.reports.report import ReportTable

PAGE = "slow-tests"
LEAST_S = 3.0
NO_REASON = "not stated: add it to `bench/figures/slow_test_reasons.py`"


@dataclass(frozen=True, slots=True)
class TimedTest:
    """One test; `seconds` include its fixtures, so the first test of a module pays for what the module shares."""

    name: str
    seconds: float

    @property
    def reason(self) -> str:
        """Why it takes so long: the reason of the longest prefix of its name that has one."""
        prefixes = [prefix for prefix in REASONS if self.name.startswith(prefix)]
        return REASONS[max(prefixes, key=len)] if prefixes else NO_REASON


def read_tests(path: Path) -> list[TimedTest]:
    """Return the tests of a JUnit XML file as pytest writes it; raises `InvalidInputError`."""
    try:
        root = ElementTree.parse(path).getroot()  # noqa: S314 - our own file
        return [
            TimedTest(_node_id(case.attrib["classname"], case.attrib["name"]), float(case.attrib["time"]))
            for case in root.iter("testcase")
        ]
    except (OSError, ElementTree.ParseError, KeyError, ValueError) as error:
        raise InvalidInputError(f"{path} is no JUnit XML file: {error}.") from None


def _node_id(module: str, test: str) -> str:
    return f"{module.replace('.', '/')}.py::{test}"


def slow_table(tests: Sequence[TimedTest], least_s: float = LEAST_S) -> ReportTable:
    """Return the tests that take longer than a limit, slowest first."""
    slow = sorted((test for test in tests if test.seconds > least_s), key=lambda test: -test.seconds)
    rows = [[f"`{test.name}`", f"{test.seconds:.1f}", test.reason] for test in slow]
    return ReportTable(["test", "seconds", "why it needs them"], rows)


def write_page(junit: Path, title: str, folder: Path = FOLDER) -> Path:
    """Write the page from pytest's file and return its path."""
    tests = read_tests(junit)
    total_s = sum(test.seconds for test in tests)
    table = slow_table(tests)
    slow_s = sum(test.seconds for test in tests if test.seconds > LEAST_S)
    summary = (
        f"{len(table.rows)} of {len(tests)} tests take more than {LEAST_S:g} s each, "
        f"{slow_s:.0f} s of {total_s:.0f} s together."
    )
    command = f"python -m bench.figures.slow_tests {junit.name}"
    return write_figures(PAGE, title, provenance(command), [summary, table], folder)


def main() -> None:
    """Read the file that is named and write the page."""
    parser = argparse.ArgumentParser(description="Write docs/figures/slow-tests.md.")
    parser.add_argument("junit", type=Path, help="what pytest --junit-xml wrote")
    parser.add_argument("--title", default="The whole suite", help="title of the section")
    arguments = parser.parse_args()
    print(f"Wrote {write_page(arguments.junit, arguments.title)}.")


if __name__ == "__main__":
    main()
