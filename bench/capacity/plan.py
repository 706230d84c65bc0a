"""The machines that a demand needs, resource by resource, and which of them runs out first."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bench.capacity.costs import Costs, Demand, Machine

DAY_S = 86_400.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What a demand needs. `first_limit` names the resource that needs most machines of one kind."""

    frames_per_second: float
    serving_cores: float
    serving_machines: int
    network_gbit_s: float
    network_machines: int
    memory_gb: float
    memory_machines: int
    commits_per_second: float
    databases: int
    build_cores: float
    storage_gb: float
    price_month: float
    first_limit: str


def plan_for(demand: Demand, costs: Costs, machine: Machine) -> Plan:
    """Return what a demand needs.

    Replicas hold no state, so that any of them answers any phone. Maps are memory-mapped: those of the buildings that
    are busy at one time should fit the memory of each replica that a balancer sends their phones to.
    """
    frames = demand.phones * demand.fps
    cores = frames * costs.session_frame_ratio * costs.query_s + demand.queries_per_second * costs.query_s
    serving = math.ceil(cores / (machine.cores * machine.use_share))
    gbit = (frames + demand.queries_per_second) * costs.frame_bytes * 8 / 1e9
    network = math.ceil(gbit / (machine.network_gbit_s * machine.use_share))
    busy = demand.buildings * demand.busy_share
    memory_gb = busy * demand.keyframes_per_building * costs.keyframe_bytes / 1e9
    memory = math.ceil(memory_gb / (machine.memory_gb * machine.use_share))
    commits_each = costs.parallel_commits / costs.commit_s * machine.use_share
    databases = max(1, math.ceil(frames / commits_each))
    build_cores = (
        demand.builds_per_day * demand.frames_per_build * costs.build_s / (DAY_S * machine.use_share)
    )
    kept = demand.buildings * demand.versions_per_building * demand.keyframes_per_building
    machines = max(serving, network, memory) + databases + math.ceil(build_cores / machine.cores)
    needs = {"database commits": databases, "cores": serving, "network": network, "memory for maps": memory}
    # One database can't be divided without changing the service, while replicas can be added: it counts first.
    first = "database commits" if databases > 1 else max(needs, key=lambda name: needs[name])
    return Plan(
        frames_per_second=frames,
        serving_cores=cores / machine.use_share,
        serving_machines=serving,
        network_gbit_s=gbit,
        network_machines=network,
        memory_gb=memory_gb,
        memory_machines=memory,
        commits_per_second=frames,
        databases=databases,
        build_cores=build_cores,
        storage_gb=kept * (costs.keyframe_bytes + costs.picture_bytes) / 1e9,
        price_month=machines * machine.price_month,
        first_limit=first,
    )
