"""What a demand needs grows with it, and the resource that runs out first is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from app.cli import app as cli
from bench.capacity.costs import Costs, Demand, Machine
from bench.capacity.measure import commit_s
from bench.capacity.plan import plan_for

COSTS = Costs(
    query_s=0.1, session_frame_ratio=0.5, frame_bytes=50_000, keyframe_bytes=100_000, picture_bytes=0
)
MACHINE = Machine(cores=10, memory_gb=100.0, network_gbit_s=1.0, use_share=0.5, price_month=100.0)
DEMAND = Demand(
    buildings=10,
    keyframes_per_building=1000,
    versions_per_building=2,
    frames_per_build=1000,
    builds_per_day=0,
    phones=100,
    fps=2.0,
    queries_per_second=0.0,
    busy_share=1.0,
)


def test_each_resource_is_counted() -> None:
    plan = plan_for(DEMAND, COSTS, MACHINE)
    # 200 frames a second of 50 ms and 50 kB; half of a machine may be in use.
    assert plan.serving_cores == pytest.approx(20.0)
    assert plan.serving_machines == 2
    assert plan.network_gbit_s == pytest.approx(0.08)
    assert plan.memory_gb == pytest.approx(1.0)
    assert plan.storage_gb == pytest.approx(2.0)
    assert (plan.databases, plan.first_limit) == (1, "cores")
    assert plan.price_month == pytest.approx(100.0 * (2 + 1))


def test_the_database_runs_out_first_with_many_phones() -> None:
    plan = plan_for(replace(DEMAND, phones=100_000), COSTS, MACHINE)
    assert plan.databases > 1
    assert plan.first_limit == "database commits"


def test_large_maps_need_memory() -> None:
    plan = plan_for(replace(DEMAND, phones=1, keyframes_per_building=1_000_000), COSTS, MACHINE)
    assert plan.first_limit == "memory for maps"
    assert plan.memory_machines == 20


def test_a_commit_takes_time() -> None:
    assert 0 < commit_s() < 10


def test_the_command_prints_what_runs_out(tmp_path: Path) -> None:
    result = CliRunner().invoke(cli, ["capacity", "--phones", "1000"])
    assert result.exit_code == 0, result.output
    assert "database" in result.output
