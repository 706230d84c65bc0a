"""Prometheus metrics, in a registry of the app's own."""

from __future__ import annotations

from collections.abc import Mapping

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    ProcessCollector,
    generate_latest,
)

from app.build_kinds import Kind
from app.services.locate_result import LocateResult

BUCKETS_S = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)


class Metrics:
    """What operators watch."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self._requests = Counter(
            "roomfix_requests_total", "HTTP requests", ["method", "route", "status"], registry=self.registry
        )
        self._seconds = Histogram(
            "roomfix_request_seconds",
            "Time of an HTTP request",
            ["route"],
            buckets=BUCKETS_S,
            registry=self.registry,
        )
        self._located = Counter(
            "roomfix_locate_total", "Queries by outcome", ["venue", "outcome"], registry=self.registry
        )
        self._by_area = Counter(
            "roomfix_locate_area_total",
            "Queries by where they were taken, or seem to have been, and by outcome",
            ["venue", "floor", "area", "outcome"],
            registry=self.registry,
        )
        self._contradicted = Counter(
            "roomfix_locate_contradicted_total",
            "Queries of which much is not what the map holds there",
            ["venue", "floor", "area"],
            registry=self.registry,
        )
        self._stages = Histogram(
            "roomfix_locate_stage_seconds",
            "Time of a query's stages",
            ["stage"],
            buckets=BUCKETS_S,
            registry=self.registry,
        )
        self._builds = Gauge(
            "roomfix_builds",
            "Builds by state, running ones by stage",
            ["state", "stage"],
            registry=self.registry,
        )
        self._queued = Gauge(
            "roomfix_builds_queued", "Builds that wait for a worker", ["kind"], registry=self.registry
        )
        self.free_bytes = Gauge(
            "roomfix_disk_free_bytes", "Free space of the data folder", registry=self.registry
        )
        self.worker_alive = Gauge(
            "roomfix_build_worker_alive", "Whether this server's build worker runs", registry=self.registry
        )
        self.damaged_maps = Gauge(
            "roomfix_venues_with_map_problem",
            "Venues whose active map can't be opened",
            registry=self.registry,
        )
        ProcessCollector(registry=self.registry)
        self.pending = Gauge("roomfix_queries_pending", "Queries that run or wait", registry=self.registry)

    def observe_request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count one request."""
        self._requests.labels(method, route, str(status)).inc()
        self._seconds.labels(route).observe(seconds)

    def observe_query(self, result: LocateResult) -> None:
        """Count one query; its outcome is `located` or the reason.

        By area only those count that a map was asked for: a session knows where its frames are, located by it or not.
        """
        outcome = result.reason or "located"
        self._located.labels(result.venue, outcome).inc()
        for stage, milliseconds in result.timings_ms.items():
            self._stages.labels(stage).observe(milliseconds / 1e3)
        if result.contradicted is None:
            return
        seen = result.suspected
        floor, plan = (result.floor, result.plan) if seen is None else (seen.floor, seen.plan)
        area = "" if plan is None or plan.area is None else plan.area
        where = result.venue, "" if floor is None else floor.id, area
        self._by_area.labels(*where, outcome).inc()
        if result.contradicted:
            self._contradicted.labels(*where).inc()

    def set_builds(self, counts: Mapping[tuple[str, str], int]) -> None:
        """State the number of builds by state and stage."""
        self._builds.clear()
        for (state, stage), count in counts.items():
            self._builds.labels(state, stage).set(count)

    def set_queued(self, counts: Mapping[Kind, int]) -> None:
        """State the number of builds of each kind that wait."""
        for kind, count in counts.items():
            self._queued.labels(kind).set(count)

    def render(self) -> bytes:
        """Return the text that Prometheus scrapes."""
        return generate_latest(self.registry)
