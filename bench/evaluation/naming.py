"""Names for build options that are compared: each by what sets it apart."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any


def name_by_difference(options: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a name for each set of options: the values that not all of them share, `defaults` for none.

    `{}` and `{"keyframes": {"thresholds": "calibrated"}}` are `defaults` and `keyframes.thresholds=calibrated`.
    A single set needs no name: it is empty.
    """
    if len(options) == 1:
        return [""]
    flat = [dict(_flattened(each)) for each in options]
    return [
        ", ".join(
            f"{name}={value}"
            for name, value in own.items()
            if any(other.get(name) != value for other in flat)
        )
        or "defaults"
        for own in flat
    ]


def _flattened(options: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    out = []
    for name, value in options.items():
        if isinstance(value, Mapping):
            out += _flattened(value, f"{prefix}{name}.")
        else:
            out.append((f"{prefix}{name}", value if isinstance(value, str) else json.dumps(value)))
    return out
