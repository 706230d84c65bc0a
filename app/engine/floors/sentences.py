"""Values and names as the sentences of errors show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class SentenceOptions:
    """How long a sentence may get by what it quotes."""

    max_characters: int = limit(
        60,
        "Characters of a quoted value before it is cut.",
        chosen="By hand: a name fits, a pasted file doesn't.",
    )
    max_names: int = limit(
        10,
        "Names that a sentence lists before it only counts the rest.",
        chosen="By hand: two lines of text.",
    )


OPTIONS = SentenceOptions()


def short(value: object) -> str:
    """Return a value as a message quotes it; long ones are cut, and other types than text and numbers are named."""
    text = repr(value) if isinstance(value, str | int | float | bool) else type(value).__name__
    return text if len(text) <= OPTIONS.max_characters else f"{text[: OPTIONS.max_characters - 3]}..."


def listed(names: Sequence[str]) -> str:
    """Return names as a message lists them: the first ones, and the number of the others."""
    shown = ", ".join(short(name) for name in names[: OPTIONS.max_names])
    others = len(names) - OPTIONS.max_names
    return f"{shown} and {others} more" if others > 0 else shown or "none"
