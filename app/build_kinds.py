"""Kinds of builds: what is known of a build before anybody has begun it."""

from __future__ import annotations

from typing import Literal, get_args

Kind = Literal["scan", "recording", "pictures"]
# Those that somebody waits for, or that take little time, first.
KINDS: tuple[Kind, ...] = get_args(Kind)


def parse_kinds(names: str) -> tuple[Kind, ...]:
    """Return the kinds of a list with commas, all for an empty one; raises `ValueError` for another name."""
    given = {name.strip() for name in names.split(",") if name.strip()}
    unknown = sorted(given.difference(KINDS))
    if unknown:
        raise ValueError(f"{unknown[0]!r} is no kind of build; the kinds are {', '.join(KINDS)}")
    return tuple(kind for kind in KINDS if kind in given) or KINDS
