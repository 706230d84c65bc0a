"""Mutants that survive, and those of them that behave as their module does: equivalent.toml says why."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path

from bench.mutation.mutants import Mutant
from bench.mutation.run import Tried

REASONS = Path(__file__).parent / "equivalent.toml"

# Function, code before, code after.
Key = tuple[str, str, str]


def key_of(mutant: Mutant) -> Key:
    """Return what a mutant is known by, wherever in the module it is."""
    return mutant.function, mutant.before, mutant.after


def read_reasons(path: str, file: Path = REASONS) -> dict[Key, str]:
    """Return why mutants of a module behave as the module does."""
    entries = tomllib.loads(file.read_text(encoding="utf-8")).get("mutant", [])
    return {
        (each["function"], each["before"], each["after"]): each["reason"]
        for each in entries
        if each["module"] == path
    }


def summary_of(tried: Sequence[Tried], reasons: dict[Key, str]) -> str:
    """Return one sentence about a module's mutants; those that don't end are killed, too."""
    left = [each.mutant for each in tried if each.outcome == "survived"]
    known = sum(key_of(mutant) in reasons for mutant in left)
    return (
        f"{len(tried)} mutants: {len(tried) - len(left)} killed, {known} behave as the module does, "
        f"{len(left) - known} open."
    )
