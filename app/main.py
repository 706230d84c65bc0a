"""The app: `create_app` and its lifespan, the only place that wires the server."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from importlib.metadata import version

from fastapi import FastAPI

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
from app.api.deps import AppState
from app.api.errors import install_error_handlers
from app.api.executor import BoundedExecutor
from app.api.guards import OtherSitesMiddleware, OverloadMiddleware
from app.api.maps import versions as map_versions
from app.api.maps import views as map_views
from app.api.metrics import Metrics
from app.api.middleware import MetricsMiddleware, RequestIdMiddleware
from app.api.requests.body_reader import RequestBodyMiddleware
from app.jobs.embedded import EmbeddedRunner
from app.jobs.runner import BuildRunner, NoRunner
from app.services.resources import Resources
from app.services.wiring import wire_services
from app.settings import Settings
from app.storage.venues import list_venues
from app.web.pages import install_pages

DESCRIPTION = (
    "Tells a camera where it is inside a building: a frame in, a pose and a point on the floor plan out."
)


def create_app(settings: Settings, runner: BuildRunner | None = None) -> FastAPI:
    """Return the app; `runner` replaces the build runner that the settings ask for."""
    metrics = Metrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        resources = Resources.open(settings)
        # The models are opened before the first query has to wait for them.
        resources.models.extractor("sift")
        logging.getLogger("roomfix").info(
            "global descriptor %s", resources.models.global_descriptor.sha256[:12]
        )
        builds = runner or (EmbeddedRunner(settings) if settings.run_worker else NoRunner())
        services = wire_services(resources)
        executor = BoundedExecutor(settings.workers, settings.queue_size)
        throttle = Throttle(settings.calls_per_minute, settings.wrong_keys_per_minute)
        app.state.roomfix = AppState(services, executor, builds, metrics, throttle)
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
            resources.close()

    app = FastAPI(
        title="Roomfix",
        version=version("roomfix"),
        description=DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
    )
    for router in (
        locate.router, venues.router, floors.router, features.router, map_versions.router, map_views.router,
        database.router, routes.router, plan_drawing.router, calibrate.router, anchors.router, sessions.router,
        session_stream.router, keys.router, keys.tokens, audit.router, health.router,
    ):  # fmt: skip
        app.include_router(router)
    install_pages(app)
    install_error_handlers(app)
    app.add_middleware(RequestBodyMiddleware, settings.max_archive_bytes, settings.max_image_bytes)
    if settings.open:
        app.add_middleware(OpenHostMiddleware)
    app.add_middleware(OverloadMiddleware)
    app.add_middleware(OtherSitesMiddleware, is_open=settings.open)
    app.add_middleware(MetricsMiddleware, metrics)
    app.add_middleware(RequestIdMiddleware)
    return app
