"""JSON of requests: each key once, and text that can be stored."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from typing import Any

from app.api.requests.names import shown
from app.api.requests.sent_values import fault_of_text
from app.errors import InvalidInputError

GZIP_MAGIC = b"\x1f\x8b"


def read_json(data: bytes | str, name: str = "The body") -> Any:
    """Return the value of JSON, which may begin with a byte order mark; `name` is what holds it, in sentences.

    Raises `InvalidInputError`.
    """
    try:
        plain = data.removeprefix("\ufeff") if isinstance(data, str) else data
        value = json.loads(plain, object_pairs_hook=_object)
        fault = _fault(value) if _has_escapes(data) else None
    except UnicodeDecodeError:
        if isinstance(data, bytes) and data.startswith(GZIP_MAGIC):
            raise InvalidInputError(f"{name} is gzip, but no Content-Encoding: gzip says so.") from None
        raise InvalidInputError(f"{name} is not JSON: its text is not UTF-8.") from None
    except RecursionError:
        raise InvalidInputError(f"{name} is not JSON that can be read: it is nested too deep.") from None
    except json.JSONDecodeError as error:
        raise InvalidInputError(f"{name} is not JSON: {error}.") from None
    except ValueError:
        # Python's limit for the digits of an integer.
        raise InvalidInputError(
            f"{name} is not JSON that can be read: a number has too many digits."
        ) from None
    if fault is not None:
        raise InvalidInputError(f"{name}, {fault}.")
    return value


def _has_escapes(data: bytes | str) -> bool:
    """Whether JSON has one of the escapes without which no text in it can be bad."""
    return "\\u" in data if isinstance(data, str) else b"\\u" in data


def _fault(value: Any) -> str | None:
    """Return where the first text is that can't be stored and why, None where all can."""
    for place, text in _texts(value, ""):
        fault = fault_of_text(text)
        if fault is not None:
            return f"{place or 'at its top'}: the text holds {fault}, which can't be stored"
    return None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        twice, _ = Counter(name for name, _ in pairs).most_common(1)[0]
        raise InvalidInputError(
            f"{shown(twice)}: this key stands twice in one object of the JSON; send it once."
        )
    return values


def _texts(value: Any, place: str) -> Iterator[tuple[str, str]]:
    """Yield each key and text of a JSON value with its place; raises `RecursionError`."""
    if isinstance(value, str):
        yield place, value
    elif isinstance(value, dict):
        for key, item in value.items():
            yield place, key
            yield from _texts(item, f"{place}.{shown(key)}" if place else shown(key))
    elif isinstance(value, list):
        for item in value:
            yield from _texts(item, place)
