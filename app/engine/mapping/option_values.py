"""Single values of a JSON object of options, checked; every message names the option."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from app.errors import InvalidInputError


def number(value: object, name: str) -> float | None:
    """Return a finite number, or None for null; raises `InvalidInputError`."""
    if value is None:
        return None
    # A whole number in JSON can be larger than any float.
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise InvalidInputError(f"{name} must be a finite number.")
    return float(value)


def count(value: object, name: str, least: int, what: str) -> int:
    """Return a whole number of at least `least`; `what` names what is counted. Raises `InvalidInputError`."""
    given = number(value, name)
    if given is None or given < least or given != int(given):
        raise InvalidInputError(f"{name} must be a whole number of {what}, {least} or more.")
    return int(given)


def flag(values: Mapping[str, Any], name: str, default: bool) -> bool:
    """Return true or false; raises `InvalidInputError`."""
    value = values.get(name, default)
    if not isinstance(value, bool):
        raise InvalidInputError(f"{name} must be true or false.")
    return value


def choice(values: Mapping[str, Any], name: str, choices: tuple[str, ...], default: str) -> str:
    """Return one of the choices; raises `InvalidInputError`."""
    value = values.get(name, default)
    if value not in choices:
        raise InvalidInputError(f"{name} must be one of {', '.join(choices)}.")
    return str(value)
