"""The app: `create_app` and its lifespan, the only place that wires the server."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version

from fastapi import FastAPI
from starlette.middleware.cors import CORSMiddleware

from app.api import (
    anchors,
    calibrate,
    database,
    features,
    floors,
    health,
    locate,
    plan_drawing,
    routes,
    session_stream,
    sessions,
    venues,
)
from app.api.access import audit, keys
from app.api.access.open_host import OpenHostMiddleware
from app.api.access.throttle import Throttle
from app.api.answers.drain import Drain, LeavingMiddleware
from app.api.answers.drawings import Drawings
from app.api.answers.head import HeadMiddleware
from app.api.answers.writing import WritingMiddleware
from app.api.deps import AppState
from app.api.errors import install_error_handlers
from app.api.executor import BoundedExecutor
from app.api.maps import left_out
from app.api.maps import versions as map_versions
from app.api.maps import views as map_views
from app.api.metrics import Metrics
from app.api.middleware import CompressionMiddleware, MetricsMiddleware, RequestIdMiddleware
from app.api.openapi import install_openapi, operation_id
from app.api.oscp import geopose as oscp_geopose
from app.api.overload import OverloadMiddleware
from app.api.requests.body_reader import RequestBodyMiddleware
from app.api.scans import inspect, recordings
from app.api.stream import asyncapi, shared_phones
from app.api.uploads import resumable
from app.api.venue_files import transfer
from app.geometry.estimators.chosen import ESTIMATORS
from app.jobs.embedded import EmbeddedRunner
from app.jobs.runner import BuildRunner, NoRunner
from app.limits import limit
from app.services.resources import Resources
from app.services.wiring import wire_services
from app.settings import Settings
from app.storage.venues import list_venues
from app.web.pages import install_pages
from app.web.phones import PhoneAccess

log = logging.getLogger("roomfix")
DESCRIPTION = (
    "Tells a camera where it is inside a building: a frame in, a pose and a point on the floor plan out."
)


# Headers of answers that scripts of other sites may read, beside the simple ones.
EXPOSED_HEADERS = (
    "ETag", "Link", "Location", "RateLimit", "RateLimit-Policy", "Retry-After", "Tus-Extension", "Tus-Max-Size",
    "Tus-Resumable", "Tus-Version", "Upload-Expires", "Upload-Length", "Upload-Offset", "X-Request-ID",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class CompressionOptions:
    """When answers are compressed."""

    min_gzip_bytes: int = limit(
        1000, "Smallest answer that is compressed.", chosen="By hand: about one packet; less gains nothing."
    )
    gzip_level: int = limit(
        4,
        "Level of gzip, 1 to 9.",
        chosen="By hand: JSON shrinks nearly as much as at 9, in a third of the time.",
    )


OPTIONS = CompressionOptions()


def create_app(
    settings: Settings, runner: BuildRunner | None = None, access: PhoneAccess | None = None
) -> FastAPI:
    """Return the app; `runner` replaces the build runner that the settings ask for, `access` is how phones reach it."""
    metrics, drain = Metrics(), Drain()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        resources = Resources.open(settings)
        # The models are opened before the first query has to wait for them.
        resources.models.extractor("sift")
        descriptor = resources.models.global_descriptor.sha256[:12]
        log.info("global descriptor %s, poses by %s", descriptor, ESTIMATORS.name)
        builds = runner or (EmbeddedRunner(settings) if settings.run_worker else NoRunner())
        services = wire_services(resources)
        executor = BoundedExecutor(settings.workers, settings.queue_size)
        throttle = Throttle(settings.calls_per_minute, settings.wrong_keys_per_minute)
        drawings = Drawings()
        app.state.roomfix = AppState(
            services=services,
            executor=executor,
            drawings=drawings,
            drain=drain,
            runner=builds,
            metrics=metrics,
            throttle=throttle,
        )
        with resources.database.read() as connection:
            warming = executor.run(
                partial(services.maps.warm, [venue.id for venue in list_venues(connection)])
            )
        # Kept, since a task that nothing refers to may be collected before it has run.
        app.state.warming = asyncio.ensure_future(warming)
        builds.start()
        try:
            yield
        finally:
            builds.stop()
            executor.close()
            drawings.close()
            resources.close()

    app = FastAPI(
        title="Roomfix",
        version=version("roomfix"),
        description=DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        generate_unique_id_function=operation_id,
    )
    include_routers(app)
    install_pages(app, access)
    install_openapi(app)
    install_error_handlers(app)
    install_middleware(app, settings, metrics, drain)
    return app


def include_routers(app: FastAPI) -> None:
    """Add the calls."""
    for router in (
        locate.router, oscp_geopose.router, venues.router, floors.router, features.router, map_versions.router,
        map_views.router, left_out.router, database.router, routes.router, plan_drawing.router, calibrate.router,
        inspect.router, anchors.router, sessions.router, session_stream.router, keys.router, keys.tokens, audit.router,
        health.router, transfer.router, asyncapi.router, recordings.router, shared_phones.router, resumable.router,
    ):  # fmt: skip
        app.include_router(router)


def install_middleware(app: FastAPI, settings: Settings, metrics: Metrics, drain: Drain) -> None:
    """Add what stands around the routes, from the innermost to the outermost."""
    app.add_middleware(RequestBodyMiddleware, settings.max_archive_bytes, settings.max_image_bytes)
    origins = settings.allowed_origins
    app.add_middleware(CompressionMiddleware, OPTIONS.min_gzip_bytes, OPTIONS.gzip_level)
    app.add_middleware(WritingMiddleware)
    app.add_middleware(OverloadMiddleware)
    if settings.open:
        app.add_middleware(OpenHostMiddleware, origins)
    if origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=origins,
            allow_methods=["*"],
            allow_headers=["*"],
            expose_headers=EXPOSED_HEADERS,
        )
    app.add_middleware(LeavingMiddleware, drain)
    # For the server that runs the app, which sees the signal to stop.
    app.state.drain = drain
    app.add_middleware(MetricsMiddleware, metrics)
    app.add_middleware(HeadMiddleware)
    app.add_middleware(RequestIdMiddleware)
