"""What no form and no query may hold, whatever its names mean: a single value twice, and text that can't be stored."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable
from typing import Any

from app.api.requests.names import shown


def value_errors(
    place: str, kind: str, items: Iterable[tuple[str, object]], lists: Collection[str], known: Collection[str]
) -> list[dict[str, Any]]:
    """Return an error for each name that was sent more than once and is none of `lists`, and for each bad text."""
    given = list(items)
    counts = Counter(name for name, _ in given)
    errors = []
    for name, count in counts.items():
        if count > 1 and name in known and name not in lists:
            more = f", and further ones as {name}s" if f"{name}s" in lists else ""
            errors.append(_error(place, name, f"this {kind} was sent {count} times; send it once{more}"))
    for name, value in given:
        fault = fault_of_text(value) if isinstance(value, str) else None
        if fault is not None:
            errors.append(_error(place, name, f"the text holds {fault}, which can't be stored"))
    return errors


def fault_of_text(text: str) -> str | None:
    """Return what a text holds that can't be stored, None for nothing."""
    if "\0" in text:
        return "a NUL character"
    if not text.isascii() and any("\ud800" <= character <= "\udfff" for character in text):
        return "half of a character (a surrogate without its other half)"
    return None


def _error(place: str, name: str, message: str) -> dict[str, Any]:
    return {"type": "sent_value", "loc": (place, shown(name)), "msg": message, "input": None}
