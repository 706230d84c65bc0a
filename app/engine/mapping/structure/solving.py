"""Adjustments of pycolmap's that report while they solve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class SolvingOptions:
    """How long an adjustment takes."""

    iterations_at_once: int = limit(
        8,
        "Iterations of the solver between two reports.",
        chosen="By hand: six seconds of a video of four minutes.",
    )
    times: int = limit(
        6, "Most times that the solver is started.", chosen="By hand: 50 iterations, as pycolmap's own."
    )


OPTIONS = SolvingOptions()


def solve_in_steps(colmap: Any, model: Any, options: Any, config: Any, report: Callable[[], None]) -> None:
    """Adjust what `config` names of pycolmap's reconstruction (`colmap` is the module).

    `report` is called before every few iterations: this adjuster holds Python's lock while it solves. What `report`
    raises leaves the reconstruction half adjusted.
    """
    options.ceres.solver_options.max_num_iterations = OPTIONS.iterations_at_once
    for _ in range(OPTIONS.times):
        report()
        found = colmap.create_default_bundle_adjuster(options, config, model).solve()
        if found.termination_type == colmap.BundleAdjustmentTerminationType.CONVERGENCE:
            break
