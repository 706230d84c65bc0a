"""Whether confidence means what it says: calibration error, and what abstaining below a confidence buys."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidInputError
from bench.evaluation.pose_errors import QueryOutcome

BINS = 10
SURE = 0.9
POOLED = "all together"


@dataclass(frozen=True, slots=True)
class Bin:
    """Located queries of neighbouring confidence: how many, their mean confidence, the share that is right."""

    count: int
    confidence: float
    right: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Reliability:
    """How confidence compares with the share of located queries within 0.5 m and 5 degrees.

    `wrong` counts located queries that are not right. `ece` is the expected calibration error, the mean distance of
    both over `bins` of equal count (None when nothing was located). `sure` counts queries at a confidence of 0.9 or
    more, `sure_wrong_percent` those of them that are wrong. `coverage` and `risk` (n,) are shares: when only the n
    surest are answered, how many of all queries that are, and how many of them are wrong.
    """

    queries: int
    located: int
    wrong: int
    ece: float | None
    sure: int
    sure_wrong_percent: float | None
    bins: tuple[Bin, ...]
    coverage: tuple[float, ...]
    risk: tuple[float, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON, without the curve."""
        out = asdict(self)
        del out["coverage"], out["risk"]
        return out


def measure_reliability(outcomes: Sequence[QueryOutcome], bins: int = BINS) -> Reliability:
    """Return how reliable the confidence of located queries is; those that weren't located have none."""
    located = sorted((o for o in outcomes if o.located), key=lambda o: -o.confidence)
    confidence = np.array([o.confidence for o in located])
    right = np.array([o.right for o in located], dtype=bool)
    parts = equal_count_bins(confidence[::-1], right[::-1], bins)
    sure = confidence >= SURE
    coverage, risk = coverage_risk(confidence, right, len(outcomes))
    return Reliability(
        queries=len(outcomes),
        located=len(located),
        wrong=int((~right).sum()),
        ece=round(sum(b.count * abs(b.confidence - b.right) for b in parts) / len(located), 4)
        if located
        else None,
        sure=int(sure.sum()),
        sure_wrong_percent=round(100 * float(1 - right[sure].mean()), 2) if sure.any() else None,
        bins=parts,
        coverage=tuple(coverage.tolist()),
        risk=tuple(risk.tolist()),
    )


def equal_count_bins(
    confidence: NDArray[np.float64], right: NDArray[np.bool_], bins: int = BINS
) -> tuple[Bin, ...]:
    """Return bins of as nearly equal count as ties allow, for confidences (n,) in ascending order.

    Equal confidences stay in one bin: split, their order alone would make an error.
    """
    if len(confidence) == 0:
        return ()
    starts = np.linspace(0, len(confidence), min(bins, len(confidence)) + 1)[:-1].astype(int)
    starts = np.unique(np.searchsorted(confidence, confidence[starts], side="left"))
    ends = [*starts[1:].tolist(), len(confidence)]
    return tuple(
        Bin(end - start, float(confidence[start:end].mean()), float(right[start:end].mean()))
        for start, end in zip(starts.tolist(), ends, strict=True)
    )


def coverage_risk(
    confidence: NDArray[np.float64], right: NDArray[np.bool_], queries: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the points of the coverage-risk curve for confidences (n,) in descending order, of `queries` in all.

    One point for each different confidence: a threshold can't part equal ones.
    """
    last = np.flatnonzero(np.append(np.diff(confidence) != 0, True)) if len(confidence) else np.zeros(0, int)
    answered = last + 1
    wrong = np.cumsum(~right)[last]
    return answered / max(queries, 1), wrong / answered


def scene_of(name: str) -> str:
    """Return the scene of a configuration's name: its first word."""
    return name.replace(",", " ").split()[0]


def with_pool(groups: Mapping[str, Sequence[QueryOutcome]]) -> dict[str, Sequence[QueryOutcome]]:
    """Return the named groups, and all of them together when there are several."""
    if len(groups) < 2:
        return dict(groups)
    return {**groups, POOLED: [outcome for group in groups.values() for outcome in group]}


def read_outcomes(path: Path, with_absent: bool = False) -> dict[str, list[QueryOutcome]]:
    """Return the outcomes in a JSON file of an evaluation by configuration, located absent places among them.

    A picture of a place that no map holds is a query as well, and right when it isn't located: those that are not
    are left out unless asked for by `with_absent`. Raises
    `InvalidInputError` for a file that is no evaluation.
    """
    try:
        parsed = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InvalidInputError(f"{path} can't be read as JSON: {error}.") from None
    found: dict[str, list[QueryOutcome]] = {}
    for item in parsed if isinstance(parsed, list) else []:
        if isinstance(item, Mapping) and isinstance(item.get("outcomes"), list):
            name = f"{item.get('name')}, {item.get('features')}"
            found.setdefault(name, []).extend(_outcomes(item, with_absent))
    if not any(found.values()):
        raise InvalidInputError(
            f"{path} holds no outcomes of queries; write it with roomfix evaluate --report or --json."
        )
    return found


def _outcomes(item: Mapping[str, Any], with_absent: bool) -> list[QueryOutcome]:
    absent = item.get("absent", {}).get("outcomes", [])
    counted = [each for each in absent if with_absent or each.get("located")]
    return [QueryOutcome.from_dict(each) for each in [*item["outcomes"], *counted]]
