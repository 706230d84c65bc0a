"""docs/limits.md: every limit of the product, found in its modules."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import app
from app.engine.query.verification import Limits
from app.limits import LimitRow, limits_of
from app.settings import Settings

# Rooms of these packages have a table each; any other package of app has one for all that is in it.
PACKAGES_OF_ROOMS = ("app.engine",)
HEAD = """# Limits

Every number of the service that was tuned: thresholds, weights, tolerances, budgets and counts. One table for each
room of the code; *limit* is the class and the field that hold the number. This page is generated from the code by
`roomfix limits`; a test fails while the two differ.

A limit with a name under *setting* can be changed for a server by that environment variable
([settings.md](settings.md)). The others are changed in the code: measure again with the command that chose them.
"""
COLUMNS = ("limit", "default", "meaning", "how chosen", "setting")


@dataclass(frozen=True, slots=True)
class Holder:
    """A class whose fields are limits, and the module that defines it."""

    module: str
    name: str
    limits: tuple[LimitRow, ...]

    @property
    def room(self) -> str:
        """The folder that the limits belong to, as a path."""
        deep = any(f"{self.module}.".startswith(f"{package}.") for package in PACKAGES_OF_ROOMS)
        parts = self.module.split(".")[: 3 if deep else 2]
        return "/".join(parts)


def limits_page() -> str:
    """Return docs/limits.md."""
    rooms: dict[str, list[Holder]] = {}
    for holder in limit_holders():
        rooms.setdefault(holder.room, []).append(holder)
    settings = settings_of_limits()
    tables = [_table(room, rooms[room], settings) for room in sorted(rooms)]
    return "\n".join([HEAD, *tables])


def limit_holders() -> list[Holder]:
    """Return every class of app with limits among its fields, by module and place in it.

    Imports all modules of app.
    """
    return [holder for module in _modules(app) for holder in _holders_in(module)]


def _modules(package: ModuleType) -> list[ModuleType]:
    names = sorted(found.name for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."))
    return [importlib.import_module(name) for name in names]


def _holders_in(module: ModuleType) -> list[Holder]:
    own = [value for value in vars(module).values() if inspect.isclass(value)]
    return [
        Holder(module.__name__, each.__name__, tuple(limits_of(each)))
        for each in dict.fromkeys(own)
        if each.__module__ == module.__name__ and dataclasses.is_dataclass(each) and limits_of(each)
    ]


def settings_of_limits() -> dict[str, str]:
    """Return, for limits that an operator may set, `module.Class.field` -> the name of the environment variable.

    Settings have the names of the limits that they replace (`app/services/localizers.py`).
    """
    names = {row.name for row in limits_of(Limits)}
    return {
        f"{Limits.__module__}.{Limits.__name__}.{name}": f"ROOMFIX_{name.upper()}"
        for name in Settings.model_fields
        if name in names
    }


def _table(room: str, holders: list[Holder], settings: Mapping[str, str]) -> str:
    lines = [f"## {room}", "", _row(COLUMNS), _row(["---"] * len(COLUMNS))]
    for holder in holders:
        for limit in holder.limits:
            variable = settings.get(f"{holder.module}.{holder.name}.{limit.name}", "")
            cells = [
                f"`{holder.name}.{limit.name}`",
                f"`{_value(limit.value)}`",
                limit.meaning,
                _with_links(limit.chosen),
                f"`{variable}`" if variable else "",
            ]
            lines.append(_row(cells))
    return "\n".join([*lines, ""])


def _row(cells: list[str] | tuple[str, ...]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _with_links(text: str) -> str:
    """Return a text in which pages of docs are links, seen from a page in docs."""
    return re.sub(r"\bdocs/([\w/-]+\.md)", r"[\1](\1)", text)


def _value(value: Any) -> str:
    """Return a default as a reader would write it: six digits of a fraction, whole numbers in full."""
    if isinstance(value, float):
        return f"{value:.0f}" if value.is_integer() else f"{value:.6g}"
    if isinstance(value, tuple | list):
        return f"({', '.join(_value(part) for part in value)})"
    return str(value)
