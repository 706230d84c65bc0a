"""What a run found as a page: modules, mutants, killed ones, and the reasons why the others mean the same."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.mutation.run import Tried

REASONS = Path(__file__).parent / "equivalent.toml"
Key = tuple[str, str, str]


@dataclass(frozen=True, slots=True)
class Survivor:
    """A mutant that no test noticed."""

    function: str
    before: str
    after: str


@dataclass(frozen=True, slots=True)
class Result:
    """What became of a module's mutants."""

    path: str
    mutants: int
    killed: int
    timed_out: int
    survivors: tuple[Survivor, ...]

    @staticmethod
    def of(path: str, tried: Sequence[Tried]) -> Result:
        """Return the result of a module's mutants; those that didn't end are killed, too."""
        left = [each.mutant for each in tried if each.outcome == "survived"]
        survivors = tuple(Survivor(mutant.function, mutant.before, mutant.after) for mutant in left)
        timed_out = sum(each.outcome == "timed out" for each in tried)
        return Result(path, len(tried), len(tried) - len(survivors), timed_out, survivors)

    def as_dict(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        return asdict(self)

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Result:
        """Return the result that `as_dict` wrote."""
        survivors = tuple(Survivor(**each) for each in values["survivors"])
        return Result(values["path"], values["mutants"], values["killed"], values["timed_out"], survivors)


def read_reasons(path: str, file: Path = REASONS) -> dict[Key, str]:
    """Return why mutants of a module behave as the module does: by function, code before and code after."""
    entries = tomllib.loads(file.read_text(encoding="utf-8")).get("mutant", [])
    return {
        (each["function"], each["before"], each["after"]): each["reason"]
        for each in entries
        if each["module"] == path
    }


def page_of(results: Sequence[Result]) -> str:
    """Return the page of results, in Markdown."""
    lines = [
        "# Mutants",
        "",
        "Each mutant is the module with one small change: another comparison, a boundary, a condition that is",
        "always or never true, a dropped part of a condition, another number, a constant in place of what is",
        "returned, a call left out. Numbers outside of functions are doubled and halved. A mutant is killed when",
        "a test fails with it, or when its tests don't end. `make mutants` writes this page; it is not part of CI.",
        "",
        "| module | mutants | killed | equivalent | open |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    details = []
    for result in results:
        reasons = read_reasons(result.path)
        known = [each for each in result.survivors if _key(each) in reasons]
        left = [each for each in result.survivors if _key(each) not in reasons]
        lines.append(f"| `{result.path}` | {result.mutants} | {result.killed} | {len(known)} | {len(left)} |")
        if result.survivors:
            details += [
                "",
                f"## {result.path}",
                "",
                "| function | change | why it survives |",
                "| --- | --- | --- |",
            ]
            details += [_row(each, reasons[_key(each)]) for each in known]
            details += [_row(each, "no test notices") for each in left]
    return "\n".join([*lines, *details]) + "\n"


def _key(survivor: Survivor) -> Key:
    return survivor.function, survivor.before, survivor.after


def _row(survivor: Survivor, reason: str) -> str:
    before, after = (code.replace("|", "\\|") for code in (survivor.before, survivor.after))
    return f"| `{survivor.function or 'module'}` | `{before}` becomes `{after}` | {reason} |"
