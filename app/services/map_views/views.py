"""What pages draw of a map version: points, keyframes with their pictures, coverage, and the view from above."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.floors.floor import Floor
from app.engine.floors.plan_point import PlanPoint, floor_of, plan_point
from app.engine.maps.artifact import MapArtifact
from app.engine.maps.drawing.coverage import Coverage, coverage_of
from app.engine.maps.drawing.points import DrawnPoints, drawn_points, thinned_rows
from app.engine.maps.drawing.top_view import blank_sheet, plan_sheet, top_view_png
from app.errors import ConflictError, NotFoundError
from app.geometry.se3 import Pose
from app.limits import limit
from app.lru import LruCache
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.storage.floors import get_floor, list_floors
from app.storage.maps import MapVersion, get_keyframe_images, get_map, list_keyframe_images
from app.vision.images import decode_image


@dataclass(frozen=True, slots=True, kw_only=True)
class MapViewOptions:
    """How much of what is drawn is kept, and how pictures are made smaller."""

    kept_bytes: int = limit(
        64_000_000,
        "Sum of the sizes of the thinned points that are kept in memory, those used last.",
        chosen="By hand: some tens of maps, since a page asks for the same points again and again.",
    )
    drawn_points: int = limit(
        200_000,
        "Points in a view from above.",
        chosen="By hand: one for each pixel of the walls of a large floor.",
    )
    jpeg_quality: int = limit(
        80, "JPEG quality of keyframe pictures that are made smaller.", chosen="By hand."
    )


OPTIONS = MapViewOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyframeView:
    """A keyframe: its name in the scan, its time where the name states one, its pose, floor and place on the plan, the
    number of its features, and whether its picture is kept."""

    keyframe: int
    name: str
    time_s: float | None
    world_from_camera: Pose
    floor: str | None
    plan: PlanPoint | None
    features: int
    has_picture: bool


class MapViews:
    """Draws map versions. Safe to share between threads."""

    def __init__(self, resources: Resources, maps: MapLibrary) -> None:
        self._resources = resources
        self._maps = maps
        self._points: LruCache[tuple[str, int], DrawnPoints] = LruCache(
            OPTIONS.kept_bytes, lambda drawn: drawn.points_in_world.nbytes + drawn.rgb.nbytes + 1
        )

    def map_blob(self, venue: str, version: int) -> str:
        """Return the digest of all that a map version's points and poses are drawn from; raises `NotFoundError`."""
        return self._version(venue, version).artifact_blob

    def points(self, venue: str, version: int, max_points: int) -> DrawnPoints:
        """Return the points of a map version, at most `max_points`; raises `NotFoundError`."""
        found = self._version(venue, version)
        key = (found.artifact_blob, max_points)
        return self._points.get_or_make(key, lambda: self._draw(found, max_points))

    def keyframes(self, venue: str, version: int) -> list[KeyframeView]:
        """Return the keyframes of a map version in their order; raises `NotFoundError`."""
        found = self._version(venue, version)
        blobs = self._pictures(found)
        artifact, floors = self._artifact(found), self._floors(venue) if found.plan_reason is None else []
        counts = np.diff(artifact.arrays.offsets)
        return [
            _keyframe(artifact, floors, k, int(counts[k]), has_picture=k < len(blobs))
            for k in range(artifact.keyframe_count)
        ]

    def picture_blob(self, venue: str, version: int, keyframe: int) -> str:
        """Return the digest of the picture of a keyframe; raises `NotFoundError`."""
        self._version(venue, version)
        with self._resources.database.read() as connection:
            images = get_keyframe_images(connection, venue, version, keyframe)
        if images is None:
            raise NotFoundError(f"Map version {version} has no picture of a keyframe {keyframe}.")
        return images.color_blob

    def picture(self, blob: str, width_px: int | None) -> bytes:
        """Return the picture with a digest as JPEG, at most `width_px` wide; raises `NotFoundError`."""
        rgb = decode_image(self._resources.blobs.get(blob), self._resources.settings.max_image_pixels)
        if width_px is not None and width_px < rgb.shape[1]:
            size = (width_px, max(1, round(rgb.shape[0] * width_px / rgb.shape[1])))
            rgb = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)
        flags = [cv2.IMWRITE_JPEG_QUALITY, OPTIONS.jpeg_quality]
        return cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), flags)[1].tobytes()

    def coverage(self, venue: str, version: int, floor: str, cell_m: float) -> Coverage:
        """Return where on a floor a phone would be located.

        Raises `NotFoundError`, and `ConflictError` for a floor that the map has no place on.
        """
        found = self._version(venue, version)
        place, plan_from_world = self._placed_floor(found, floor)
        artifact = self._artifact(found)
        return coverage_of(artifact, plan_from_world, _on_floor(artifact, place), cell_m)

    def top_view(self, venue: str, version: int, floor: str | None, width_px: int) -> bytes:
        """Return the PNG of a floor from above; without a floor all of the map, in the axes of the world.

        Raises `NotFoundError`, and `ConflictError` for a floor that the map has no place on.
        """
        found = self._version(venue, version)
        artifact = self._artifact(found)
        drawn = self.points(venue, version, OPTIONS.drawn_points)
        if floor is None:
            xy = drawn.points_in_world[:, :2].astype(np.float64)
            return top_view_png(blank_sheet(xy, width_px), drawn, xy, artifact.arrays.positions[:, :2])
        place, plan_from_world = self._placed_floor(found, floor)
        z = drawn.points_in_world[:, 2]
        here = (z >= place.z_min_m) & (z <= place.z_max_m)
        drawn = DrawnPoints(drawn.points_in_world[here], drawn.rgb[here])
        xy = _on_plan(plan_from_world, drawn.points_in_world)
        keyframes = _on_plan(plan_from_world, artifact.arrays.positions[_on_floor(artifact, place)])
        if place.plan is None:
            sheet = blank_sheet(xy, width_px)
        else:
            image = self._resources.blobs.get(place.plan.blob)
            sheet = plan_sheet(
                decode_image(image, self._resources.settings.max_image_pixels), place.plan, width_px
            )
        return top_view_png(sheet, drawn, xy, keyframes)

    def _version(self, venue: str, version: int) -> MapVersion:
        with self._resources.database.read() as connection:
            return get_map(connection, venue, version)

    def _pictures(self, found: MapVersion) -> list[str]:
        """Return the blobs of the keyframes' pictures, none for a map that was built without them."""
        with self._resources.database.read() as connection:
            images = list_keyframe_images(connection, found.venue_id, found.version)
        return [each.color_blob for each in images]

    def _artifact(self, version: MapVersion) -> MapArtifact:
        return self._maps.open(version).artifact

    def _floors(self, venue: str) -> list[Floor]:
        with self._resources.database.read() as connection:
            return list_floors(connection, venue)

    def _placed_floor(self, version: MapVersion, floor: str) -> tuple[Floor, NDArray[np.float64]]:
        with self._resources.database.read() as connection:
            place = get_floor(connection, version.venue_id, floor)
        if not version.has_scale:
            raise ConflictError(
                "This map has no scale, so it has no place on a floor: build it with scale in the options."
            )
        if not version.z_up:
            raise ConflictError(
                "It is not known which way is up in this map, so it has no place on a floor: build it with gravity or "
                "world_from_scan."
            )
        if place.plan_from_world is None:
            raise ConflictError(
                f"Floor {floor!r} has no plan_from_world, so the map has no place on its plan: align the two first."
            )
        return place, place.plan_from_world

    def _draw(self, version: MapVersion, max_points: int) -> DrawnPoints:
        artifact, blobs = self._artifact(version), self._pictures(version)

        def picture_of(keyframe: int) -> NDArray[np.uint8] | None:
            return self._small_picture(blobs[keyframe]) if keyframe < len(blobs) else None

        return drawn_points(artifact, thinned_rows(artifact, max_points), picture_of)

    def _small_picture(self, blob: str) -> NDArray[np.uint8] | None:
        """Return a keyframe's picture in RGB at half its size where its format allows, None if it is lost."""
        try:
            data = self._resources.blobs.get(blob)
        except NotFoundError:
            return None
        flags = cv2.IMREAD_REDUCED_COLOR_2 | cv2.IMREAD_IGNORE_ORIENTATION
        decoded = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        if decoded is None:
            return decode_image(data, self._resources.settings.max_image_pixels)
        return np.asarray(cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB), np.uint8)


def _keyframe(
    artifact: MapArtifact, floors: list[Floor], keyframe: int, features: int, *, has_picture: bool
) -> KeyframeView:
    pose, name = artifact.pose(keyframe), artifact.metadata.keyframe_names[keyframe]
    floor = floor_of(floors, pose)
    return KeyframeView(
        keyframe=keyframe,
        name=name,
        time_s=_time_of(name),
        world_from_camera=pose,
        floor=None if floor is None else floor.id,
        plan=None if floor is None else plan_point(floor, pose),
        features=features,
        has_picture=has_picture,
    )


def _time_of(name: str) -> float | None:
    """Return the seconds that a frame's file name states, as in `rgb/1305031790.645155.png`, else None."""
    stem = name.rpartition("/")[2].rpartition(".")[0]
    whole, dot, decimals = stem.partition(".")
    return float(stem) if dot and whole.isdecimal() and decimals.isdecimal() else None


def _on_floor(artifact: MapArtifact, floor: Floor) -> NDArray[np.intp]:
    z = artifact.arrays.positions[:, 2]
    return np.flatnonzero((z >= floor.z_min_m) & (z <= floor.z_max_m))


def _on_plan(plan_from_world: NDArray[np.float64], points: NDArray[np.floating]) -> NDArray[np.float64]:
    moved = points.astype(np.float64) @ plan_from_world[:3, :3].T + plan_from_world[:3, 3]
    return np.asarray(moved[:, :2])
