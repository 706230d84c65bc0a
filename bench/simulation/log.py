"""A file of the walks of a simulation, a line of JSON for each as it ends: what was walked is not walked again."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from app.errors import InvalidInputError
from bench.simulation.summary import Setting
from bench.simulation.walks import Outcome


class WalkLog:
    """The walks in a file, by what makes each of them the same when walked again. Without a file there are none."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._known: dict[str, Outcome] = {}
        if path is not None and path.exists():
            for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
                self._read(line, number)

    def _read(self, line: str, number: int) -> None:
        try:
            values = json.loads(line)
            # Files of earlier walks have no frames beyond three sigmas.
            outcome = Outcome(**{"beyond_frames": 0, **values["outcome"]})
            self._known[_key(values["walk"])] = outcome
        except (ValueError, KeyError, TypeError) as error:
            raise InvalidInputError(
                f"Line {number} of {self._path} is no walk of roomfix simulate: remove it, or name another file."
            ) from error

    def get(self, walk: Mapping[str, Any]) -> Outcome | None:
        """Return what came of a walk, None for one that was not walked."""
        return self._known.get(_key(walk))

    def walks(self) -> Iterator[tuple[Setting, Outcome]]:
        """Yield all walks with how they were walked."""
        for key, outcome in self._known.items():
            values = json.loads(key)
            yield (
                Setting(**{each.name: values[each.name] for each in fields(Setting) if each.name in values}),
                outcome,
            )

    def add(self, walk: Mapping[str, Any], outcome: Outcome) -> None:
        """Add a walk; it is in the file when this returns."""
        self._known[_key(walk)] = outcome
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"walk": dict(walk), "outcome": asdict(outcome)}) + "\n")


def _key(walk: Mapping[str, Any]) -> str:
    return json.dumps(dict(walk), sort_keys=True)
