"""Limits as values: a tuned number with what it means and how it was chosen.

A room's limits are frozen dataclasses whose fields are made by `limit`, beside the code that uses them.
`docs/limits.md` is made from all of them.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, TypeVar

T = TypeVar("T")


def limit(default: T, meaning: str, *, chosen: str) -> T:
    """Return a dataclass field that holds a limit.

    `meaning` is one plain sentence, its unit in the field's name; `chosen` says how the value was chosen: the command
    that measured it and where the figures are, or that it was set by hand and why.
    """
    return dataclasses.field(default=default, metadata={"meaning": meaning, "chosen": chosen})


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitRow:
    """One limit as documentation shows it."""

    name: str
    value: Any
    meaning: str
    chosen: str


def limits_of(options: type) -> list[LimitRow]:
    """Return the limits among the fields of a dataclass, in their order."""
    return [
        LimitRow(
            name=field.name,
            value=field.default,
            meaning=field.metadata["meaning"],
            chosen=field.metadata["chosen"],
        )
        for field in dataclasses.fields(options)
        if "meaning" in field.metadata
    ]
