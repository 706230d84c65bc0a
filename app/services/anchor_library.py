"""The anchors of a venue with the features of their newest frames, kept while a frame is the newest."""

from __future__ import annotations

from dataclasses import dataclass

from app.engine.anchors.features import AnchorFeatures
from app.engine.anchors.live_anchor import LiveAnchor, mounted_camera
from app.limits import limit
from app.lru import LruCache
from app.services.floor_features import FeatureLibrary
from app.services.resources import Resources
from app.storage.anchors import frame_features, list_anchors, list_frames
from app.storage.db import now
from app.storage.floors import list_floors


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorCacheOptions:
    """How many frames' features stay in memory."""

    frames: int = limit(
        64,
        "Newest frames of monitoring cameras whose features are kept in memory, those used last.",
        chosen="By hand: about 4 MB each with the unit vectors that matching needs, so 256 MB at most.",
    )


OPTIONS = AnchorCacheOptions()


class AnchorLibrary:
    """Gives the anchors that can be used now. Safe to share between threads."""

    def __init__(self, resources: Resources, floor_features: FeatureLibrary) -> None:
        self._resources = resources
        self._floor_features = floor_features
        self._open: LruCache[str, AnchorFeatures] = LruCache(OPTIONS.frames)

    def live(self, venue_id: str, floor_id: str | None = None) -> list[LiveAnchor]:
        """Return the anchors of a venue, or of one floor, whose newest frame is not too old."""
        default = self._resources.settings.anchor_max_age_s
        with self._resources.database.read() as connection:
            floors = {floor.id: floor for floor in list_floors(connection, venue_id)}
            anchors = [
                anchor
                for anchor in list_anchors(connection, venue_id)
                if floor_id is None or anchor.spec.floor_id == floor_id
            ]
            frames = list_frames(connection, [anchor.id for anchor in anchors])
        present = now()
        found = []
        for anchor in anchors:
            frame = frames.get(anchor.id)
            limit_s = default if anchor.spec.max_age_s is None else anchor.spec.max_age_s
            if frame is None or (present - frame.received_at).total_seconds() > limit_s:
                continue
            features = self._features(frame.id)
            if features is not None:
                floor = floors[anchor.spec.floor_id]
                found.append(
                    LiveAnchor(
                        anchor=anchor,
                        frame=frame.id,
                        camera=frame.camera,
                        features=features,
                        mounted=mounted_camera(anchor.calibration, floor),
                        walls=self._floor_features.walls(floor),
                    )
                )
        return found

    def _features(self, frame_id: str) -> AnchorFeatures | None:
        features = self._open.get(frame_id)
        if features is not None:
            return features
        with self._resources.database.read() as connection:
            packed = frame_features(connection, frame_id)
        if packed is None:
            return None
        features = AnchorFeatures.unpack(packed)
        if features is not None:
            self._open.put(frame_id, features)
        return features
