"""`roomfix capacity`: the machines that many buildings and phones need, and what runs out first."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from bench.capacity.costs import Costs, Demand, Machine
from bench.capacity.measure import commit_s, map_costs
from bench.capacity.plan import Plan, plan_for
from bench.figures.shown import FiguresTitle, Shown


def capacity(
    buildings: Annotated[int, typer.Option(min=1, help="Buildings with a map.")] = 1000,
    phones: Annotated[int, typer.Option(min=0, help="Phones that stream at the same time.")] = 10_000,
    fps: Annotated[float, typer.Option(min=0.1, help="Frames a second of each phone.")] = 2.0,
    queries: Annotated[float, typer.Option(min=0.0, help="Single queries a second beside them.")] = 100.0,
    keyframes: Annotated[int, typer.Option(min=1, help="Keyframes of a building.")] = 2000,
    versions: Annotated[int, typer.Option(min=1, help="Map versions kept for each building.")] = 3,
    builds: Annotated[int, typer.Option(min=0, help="Builds a day.")] = 200,
    frames: Annotated[int, typer.Option(min=1, help="Frames of a scan.")] = 10_000,
    busy: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of the buildings in use at one time.")
    ] = 0.5,
    cores: Annotated[int, typer.Option(min=1, help="Cores of a machine.")] = 32,
    memory: Annotated[float, typer.Option(min=1.0, help="Memory of a machine in GB.")] = 128.0,
    network: Annotated[float, typer.Option(min=0.1, help="Network of a machine in Gbit/s.")] = 10.0,
    use: Annotated[
        float, typer.Option(min=0.1, max=1.0, help="Share of a machine that may be in use.")
    ] = 0.6,
    price: Annotated[
        float, typer.Option(min=0.0, help="Price of a machine a month, in any currency.")
    ] = 250.0,
    measure: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            file_okay=False,
            help="Measure by the maps of a data directory.",
        ),
    ] = None,
    database: Annotated[
        str | None, typer.Option(help="With --measure: the URL of an empty database to time.")
    ] = None,
    figures: FiguresTitle = None,
) -> None:
    """Print what a demand needs of machines by what one query, frame, keyframe and commit cost."""
    costs = Costs() if measure is None else _measured(measure, database)
    machine = Machine(cores=cores, memory_gb=memory, network_gbit_s=network, use_share=use, price_month=price)
    shown = Shown()
    shown.table(_costs_table(costs))
    demand = Demand(
        buildings=buildings,
        keyframes_per_building=keyframes,
        versions_per_building=versions,
        frames_per_build=frames,
        builds_per_day=builds,
        phones=phones,
        fps=fps,
        queries_per_second=queries,
        busy_share=busy,
    )
    shown.table(_plans_table(demand, costs, machine))
    shown.write("capacity", figures)


ROWS = (
    "frames a second", "cores", "machines for cores", "Gbit/s", "machines for network", "GB of open maps",
    "machines for memory", "databases for commits", "cores for builds", "TB stored", "price a month", "runs out first",
)  # fmt: skip


def _plans_table(demand: Demand, costs: Costs, machine: Machine) -> Table:
    """Return what a hundredth, a tenth and all of the phones need."""
    shares = (0.01, 0.1, 1.0)
    plans = [
        plan_for(
            replace(
                demand,
                phones=round(share * demand.phones),
                queries_per_second=share * demand.queries_per_second,
            ),
            costs,
            machine,
        )
        for share in shares
    ]
    size = f"{demand.buildings:,} buildings of {demand.keyframes_per_building:,} keyframes"
    title = f"{size}, {demand.fps:g} frames a second of each phone"
    table = Table("phones", *(f"{round(share * demand.phones):,}" for share in shares), title=title)
    for name, values in zip(ROWS, zip(*map(_row, plans), strict=True), strict=True):
        table.add_row(name, *values)
    return table


def _row(plan: Plan) -> tuple[str, ...]:
    return (
        f"{plan.frames_per_second:,.0f}",
        f"{plan.serving_cores:,.0f}",
        str(plan.serving_machines),
        f"{plan.network_gbit_s:.2f}",
        str(plan.network_machines),
        f"{plan.memory_gb:,.0f}",
        str(plan.memory_machines),
        str(plan.databases),
        f"{plan.build_cores:.1f}",
        f"{plan.storage_gb / 1000:.2f}",
        f"{plan.price_month:,.0f}",
        plan.first_limit,
    )


def _measured(data_dir: Path, database: str | None) -> Costs:
    maps = map_costs(data_dir)
    costs = replace(Costs(), commit_s=commit_s(database))
    if maps is None:
        return costs
    return replace(costs, keyframe_bytes=round(maps.keyframe_bytes), build_s=maps.build_s)


def _costs_table(costs: Costs) -> Table:
    table = Table("cost", "value", title="Costs")
    table.add_row("core time of a query", f"{1e3 * costs.query_s:.0f} ms")
    table.add_row(
        "core time of a session's frame", f"{1e3 * costs.query_s * costs.session_frame_ratio:.0f} ms"
    )
    table.add_row("bytes of a frame", f"{costs.frame_bytes:,}")
    table.add_row("bytes of a keyframe", f"{costs.keyframe_bytes:,}")
    table.add_row("bytes of its pictures", f"{costs.picture_bytes:,}")
    table.add_row("core time of a build, a frame", f"{1e3 * costs.build_s:.0f} ms")
    table.add_row("a commit of a frame", f"{1e3 * costs.commit_s:.2f} ms, {costs.parallel_commits} at once")
    return table
