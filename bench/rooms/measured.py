"""Results that are kept in a file while a comparison is run in parts."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from app.errors import InvalidInputError
from bench.figures.provenance import ROOT, commit_of
from bench.rooms.compare import RoomResult


class MeasuredResults:
    """The results of one commit, written to a file after each one; without a path they are only kept."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.results: list[RoomResult] = []

    @staticmethod
    def of_file(path: Path | None, root: Path = ROOT) -> MeasuredResults:
        """Return what a file holds, if it is there.

        Raises `InvalidInputError` for results of another commit, which must not stand in one table with new ones.
        """
        found = MeasuredResults(path)
        if path is not None and path.is_file():
            values = json.loads(path.read_text(encoding="utf-8"))
            if any(each["commit"] != _commit(root) for each in values):
                raise InvalidInputError(f"{path.name} holds results of another commit; remove it.")
            found.results = [RoomResult.from_dict(each) for each in values]
        return found

    def add(self, results: Iterable[RoomResult], root: Path = ROOT) -> None:
        """Add results."""
        self.results += results
        if self._path is not None:
            commit = _commit(root)
            values = [{**each.as_dict(), "commit": commit} for each in self.results]
            self._path.write_text(json.dumps(values, indent=1, allow_nan=False), encoding="utf-8")


def _commit(root: Path) -> str | None:
    """Return the commit of a checkout, None without git."""
    try:
        return commit_of(root)
    except InvalidInputError:
        return None
