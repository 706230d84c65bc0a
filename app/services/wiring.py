"""The services of one process, wired once: what the server, the commands and the bench call."""

from __future__ import annotations

from dataclasses import dataclass

from app.engine.anchors.features import AnchorDescriber
from app.engine.tracking.settings import TrackerSettings
from app.services.anchor_locator import AnchorLocator
from app.services.anchors import AnchorService
from app.services.floor_features import FeatureLibrary
from app.services.keys.key_service import KeyService
from app.services.locate import LocateService
from app.services.map_library import MapLibrary
from app.services.map_views.views import MapViews
from app.services.recordings.service import RecordingService
from app.services.resources import Resources
from app.services.routes import RouteService
from app.services.sessions import SessionService
from app.storage.uploads import UploadFolder


@dataclass(frozen=True, slots=True, kw_only=True)
class Services:
    """All services on the same resources and caches."""

    resources: Resources
    maps: MapLibrary
    map_views: MapViews
    features: FeatureLibrary
    routes: RouteService
    anchors: AnchorService
    locate: LocateService
    sessions: SessionService
    keys: KeyService
    recordings: RecordingService
    uploads: UploadFolder


def wire_services(resources: Resources, tracking: TrackerSettings | None = None) -> Services:
    """Return the services on these resources; `tracking` replaces the tracker's settings."""
    maps, features = MapLibrary(resources), FeatureLibrary(resources.database)
    routes = RouteService(resources.database, features)
    describer = AnchorDescriber()
    locator = AnchorLocator(resources, describer, features)
    return Services(
        resources=resources,
        maps=maps,
        map_views=MapViews(resources, maps),
        features=features,
        routes=routes,
        anchors=AnchorService(resources, maps, describer),
        locate=LocateService(resources, maps, features, locator),
        uploads=UploadFolder(
            resources.settings.uploads_dir,
            resources.settings.max_archive_bytes,
            is_store_here=resources.settings.blob_url is None,
        ),
        keys=KeyService(resources.database, resources.settings.admin_key),
        recordings=RecordingService(resources),
        sessions=SessionService(resources, maps, features, routes, locator, tracking),
    )
