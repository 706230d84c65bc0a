"""Unknown names in a request: each is refused with the name that was probably meant."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches

from app.errors import InvalidInputError
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class NameOptions:
    """When an unknown name is taken for a misspelt one, and how much of it is repeated."""

    min_similarity_ratio: float = limit(
        0.6,
        "Least similarity (ratio of difflib) of an unknown name to the known one that is suggested.",
        chosen="By hand: the default of difflib; one wrong letter in five stays above it.",
    )
    min_mentioned_characters: int = limit(
        4,
        "Least length of an unknown name that is searched for in the descriptions of the known ones.",
        chosen="By hand: shorter names (x, fx, px) stand in descriptions as parts of formulas.",
    )
    max_reported_names: int = limit(
        2,
        "Largest number of unknown names that an answer lists.",
        chosen="By hand: with the names that are known beside each, the sentence stays below 500 characters.",
    )
    max_name_characters: int = limit(
        40,
        "Number of characters of an unknown name that are repeated and compared.",
        chosen="By hand: longer than any known name.",
    )


OPTIONS = NameOptions()


@dataclass(frozen=True, slots=True)
class Known:
    """A name that is known: how a client writes it, and its description."""

    written: str
    description: str = ""


def known_names(names: Iterable[str]) -> dict[str, Known]:
    """Return names without descriptions."""
    return {name: Known(name) for name in names}


def unknown_names(given: Iterable[object], known: Mapping[str, Known]) -> list[str]:
    """Return the given names that are not known, each once; no more than an answer lists."""
    unknown = dict.fromkeys(str(name) for name in given if name not in known)
    return list(unknown)[: OPTIONS.max_reported_names]


def shown(name: str) -> str:
    """Return an unknown name as an answer may repeat it: short and printable."""
    short = name[: OPTIONS.max_name_characters]
    return "".join(c if c.isprintable() else "?" for c in short) + ("..." if len(name) > len(short) else "")


def probably_meant(name: str, known: Mapping[str, Known]) -> str | None:
    """Return the known name that an unknown one is most like, else one whose description mentions it."""
    plain = {_plain(key): known[key].written for key in known}
    close = get_close_matches(_plain(name), plain, 1, OPTIONS.min_similarity_ratio)
    if close:
        return plain[close[0]]
    if not OPTIONS.min_mentioned_characters <= len(name) <= OPTIONS.max_name_characters:
        return None
    word = re.compile(rf"\b{re.escape(name)}\b", re.IGNORECASE)
    return next((entry.written for entry in known.values() if word.search(entry.description)), None)


def refusal(
    name: str,
    known: Mapping[str, Known],
    others: Mapping[str, Known],
    kind: str = "field",
    given: Iterable[object] = (),
) -> str:
    """Return what is said of an unknown name.

    `known` are the names that could stand in its place, of which those that are `given` too were not meant; `others`
    are those that belong elsewhere in the request.
    """
    missing = {key: known[key] for key in known if key not in set(given)}
    meant = probably_meant(name, {**others, **missing})
    if meant is not None:
        return f"this {kind} is not known; did you mean {meant}?"
    if not known:
        return f"this {kind} is not known; the call takes none"
    return f"this {kind} is not known; there are {', '.join(entry.written for entry in known.values())}"


def refuse_unknown_keys(values: object, known: Mapping[str, Known], place: str = "") -> None:
    """Raise `InvalidInputError` for the first key of a JSON object that is not known; other values pass."""
    if not isinstance(values, Mapping):
        return
    for name in unknown_names(values, known):
        path = f"{place}.{shown(name)}" if place else shown(name)
        raise InvalidInputError(f"{path}: {refusal(name, known, {}, given=values)}")


def _plain(name: str) -> str:
    return name[: OPTIONS.max_name_characters].lower().replace("-", "_")
