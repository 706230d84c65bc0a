"""What a section of figures says about its measurement: command line, commit, date, machine."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path, PurePath

from app.errors import InvalidInputError
from bench.evaluation.benchmark import describe_machine

ROOT = Path(__file__).parents[2]
# Options that say where results are written and in which parts, and nothing about what is measured.
OUTPUT_OPTIONS = ("--figures", "--json", "--report", "--plot", "--out", "--part-minutes")
# A measurement with changes in these folders is not one of the commit.
MEASURED = ("app", "bench")


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where figures come from."""

    command: str
    commit: str
    date: str
    machine: str

    def lines(self) -> list[str]:
        """Return the header of a section, as Markdown."""
        return [
            f"- command: `{self.command}`",
            f"- commit: {self.commit}",
            f"- date: {self.date}",
            f"- machine: {self.machine}",
        ]


def provenance(command: str, root: Path = ROOT) -> Provenance:
    """Return command line, commit of the checkout, today's date and this machine.

    Raises `InvalidInputError` where there is no git checkout.
    """
    return Provenance(command, commit_of(root), date.today().isoformat(), machine())


def command_line(arguments: Sequence[str] | None = None) -> str:
    """Return the command line of this process, or of other arguments, as a reader can repeat it elsewhere.

    Options that name output files are left out, and absolute paths are cut to their last part.
    """
    given = iter(sys.argv[1:] if arguments is None else arguments)
    kept = ["roomfix"]
    for argument in given:
        if argument in OUTPUT_OPTIONS:
            next(given, None)
        elif not argument.startswith(tuple(f"{option}=" for option in OUTPUT_OPTIONS)):
            kept.append(_without_folders(argument))
    return shlex.join(kept)


def _without_folders(argument: str) -> str:
    path = PurePath(argument)
    return path.name if path.is_absolute() or ".." in path.parts else argument


def commit_of(root: Path) -> str:
    """Return the commit of a checkout as Markdown, and whether its code has changes that are not committed."""
    name = f"`{_git(root, 'rev-parse', '--short', 'HEAD')}`"
    changed = _git(root, "status", "--porcelain", "--", *MEASURED)
    return f"{name}, with changes that are not committed" if changed else name


def _git(root: Path, *arguments: str) -> str:
    try:
        done = subprocess.run(  # noqa: S603
            ["git", "-C", str(root), *arguments],  # noqa: S607
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        raise InvalidInputError("Figures are written in a git checkout only: they name its commit.") from None
    return done.stdout.strip()


def machine() -> str:
    """Return the processor and how many of its cores this process may use."""
    return f"{describe_machine()['processor']}, {len(os.sched_getaffinity(0))} CPUs"
