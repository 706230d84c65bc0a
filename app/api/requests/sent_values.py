"""What no form and no query may hold, whatever its names mean: a single value twice, and text that can't be stored."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable
from typing import Any

from app.api.requests.names import shown


def repeated_errors(
    place: str, kind: str, names: Iterable[str], lists: Collection[str], known: Collection[str]
) -> list[dict[str, Any]]:
    """Return an error for each name that was sent more than once and is none of `lists`."""
    counts = Counter(names)
    errors = []
    for name, count in counts.items():
        if count > 1 and name in known and name not in lists:
            more = f", and further ones as {name}s" if f"{name}s" in lists else ""
            errors.append(_error(place, name, f"this {kind} was sent {count} times; send it once{more}"))
    return errors


def text_errors(place: str, items: Iterable[tuple[str, object]]) -> list[dict[str, Any]]:
    """Return an error for each text that can't be stored."""
    faults = ((name, fault_of_text(value)) for name, value in items if isinstance(value, str))
    return [
        _error(place, name, f"the text holds {fault}, which can't be stored")
        for name, fault in faults
        if fault
    ]


def fault_of_text(text: str) -> str | None:
    """Return what a text holds that can't be stored, None for nothing."""
    if "\0" in text:
        return "a NUL character"
    if not text.isascii() and any("\ud800" <= character <= "\udfff" for character in text):
        return "half of a character (a surrogate without its other half)"
    return None


def _error(place: str, name: str, message: str) -> dict[str, Any]:
    return {"type": "sent_value", "loc": (place, shown(name)), "msg": message, "input": None}
