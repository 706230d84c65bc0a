"""Adjustments of pycolmap's that report while they solve."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def solve_in_steps(
    colmap: Any,
    model: Any,
    options: Any,
    config: Any,
    *,
    iterations_at_once: int,
    times: int,
    report: Callable[[], None],
) -> None:
    """Adjust what `config` names of pycolmap's reconstruction (`colmap` is the module).

    `report` is called before each of at most so many `times` that the solver is started: this adjuster holds Python's
    lock while it solves. What `report` raises leaves the reconstruction half adjusted.
    """
    options.ceres.solver_options.max_num_iterations = iterations_at_once
    for _ in range(times):
        report()
        found = colmap.create_default_bundle_adjuster(options, config, model).solve()
        if found.termination_type == colmap.BundleAdjustmentTerminationType.CONVERGENCE:
            break
