"""What came of every mistake, kept in a file so that a long measurement can be made in parts."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from app.errors import InvalidInputError
from bench.examination.mistakes import Examined
from bench.examination.repaired_maps import Located

RIGHT = "as it is"


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """What came of one scan, and the commit that it was measured at."""

    name: str
    is_mistake: bool
    verdict: str
    named: bool
    codes: tuple[str, ...]
    sentence: str
    seconds: float
    repairs: Mapping[str, Any] | None
    located: Located | None
    commit: str

    @staticmethod
    def of(examined: Examined, located: Located | None, is_mistake: bool, commit: str) -> Row:
        """Return the row of a scan that was examined."""
        usable = examined.usable
        return Row(
            name=examined.name,
            is_mistake=is_mistake,
            verdict=examined.verdict,
            named=examined.named,
            codes=examined.codes,
            sentence=examined.sentence,
            seconds=round(examined.seconds, 2),
            repairs=None if usable is None else usable.repairs_report().get("repairs"),
            located=located,
            commit=commit,
        )

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> Row:
        """Return a row that was read from JSON."""
        located = values["located"]
        return Row(
            **{
                **values,
                "codes": tuple(values["codes"]),
                "located": None if located is None else Located.from_dict(located),
            }
        )

    @property
    def serves(self) -> bool:
        """Whether a map of the scan would serve without `repair`: what was not located in counts as a map that does."""
        return self.verdict != "refused" and (self.located is None or self.located.refusal is None)

    @property
    def is_warned_of(self) -> bool:
        """Whether the examination or the finished map's self-check says anything."""
        return bool(self.codes) or (self.located is not None and bool(self.located.warnings))


@dataclass(frozen=True, slots=True)
class Record:
    """The rows of a file that were asked for with the same arguments."""

    path: Path | None
    asked: Mapping[str, Any]
    rows: dict[str, Row]

    @staticmethod
    def at(path: Path | None, asked: Mapping[str, Any]) -> Record:
        """Return the rows of a file, none where there is no file yet.

        Raises `InvalidInputError` for a file of other arguments, which would otherwise be lost.
        """
        if path is None or not path.is_file():
            return Record(path, asked, {})
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))
            rows = [Row.from_dict(values) for values in kept["rows"]]
            before = kept["asked"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InvalidInputError(f"{path} holds no rows of this command: {error}.") from None
        if before != asked:
            raise InvalidInputError(f"{path} holds what was measured with other arguments: {before}.")
        return Record(path, asked, {row.name: row for row in rows})

    def add(self, row: Row) -> None:
        """Keep a row, and write the file anew."""
        self.rows[row.name] = row
        if self.path is not None:
            rows = [asdict(each) for each in self.rows.values()]
            self.path.write_text(json.dumps({"asked": self.asked, "rows": rows}, indent=1), encoding="utf-8")


def summary(rows: Sequence[Row], commit: str) -> list[str]:
    """Return sentences that compare the rows with what must hold: what serves, what is named, what is located; and
    their commits where they are not all of this `commit`."""
    mistakes, right = [row for row in rows if row.is_mistake], [row for row in rows if not row.is_mistake]
    named = sum(row.named for row in mistakes)
    lines = []
    if mistakes:
        lines.append(
            f"Mistakes: {len(mistakes)}. Of these {sum(row.serves for row in mistakes)} serve, and {named} are named "
            "by the right cause."
        )
    if right:
        unknown = [row for row in right if row.verdict == "unknown" and row.named]
        warned = sum(row.is_warned_of for row in right) - len(unknown)
        lines.append(
            f"Right scans: {len(right)}. Of these {sum(row.verdict == 'refused' for row in right)} are refused and "
            f"{warned} warned of."
        )
        lines.extend(
            f"Nothing can be said of {row.name}: more than half of its frames show less than half of what their "
            "neighbours show."
            for row in unknown
        )
    reference = next((row.located for row in right if row.name == RIGHT), None)
    repaired = [(row.name, row.located) for row in mistakes if row.repairs and row.located is not None]
    if reference is not None and repaired:
        fewest = min(repaired, key=lambda pair: pair[1].located)
        largest = max(repaired, key=lambda pair: pair[1].median_m or 0.0)
        lines.append(
            f"Maps of repaired scans: {len(repaired)}. The right scan's locates {reference.words}; of the others "
            f"the fewest are located by that of {fewest[0]}: {fewest[1].words}; the largest median error is that of "
            f"{largest[0]}: {largest[1].words}."
        )
    commits = {row.commit for row in rows}
    if not commits <= {commit}:
        lines.append(f"The rows were measured at {' and '.join(sorted(commits))}.")
    return lines
