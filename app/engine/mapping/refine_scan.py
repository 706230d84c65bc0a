"""The points of a scan's keyframes and its camera, refined by all views of the scan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

from app.engine.mapping.scan_lens import learn_lens
from app.engine.mapping.sensor_depth import corrected, learn_depth_response
from app.engine.mapping.supporting_frames import nearest_keyframe, with_supporting_features
from app.engine.maps.points import MapPoints, View, nearby_views, refined_points
from app.engine.progress import Progress, map_in_order
from app.geometry.camera import Camera
from app.vision.features import LocalFeatureExtractor


@dataclass(frozen=True, slots=True)
class RefinedScan:
    """The points of each keyframe, and the camera with the lens that the views show.

    `lens_sigma` is the standard deviation of the lens's coefficient, 0 where the camera is as stated.
    """

    points: list[MapPoints]
    camera: Camera
    lens_sigma: float = 0.0


def refined_scan(
    views: Mapping[int, View],
    keyframes: Sequence[int],
    sharp: Sequence[int],
    camera: Camera,
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
    *,
    has_sensor: bool = True,
) -> RefinedScan:
    """Return the points of each keyframe and the camera; `keyframes` and `sharp` are rows of `views`.

    `has_sensor` says that depths are those of a sensor, whose error is learned, and not triangulated.

    The lens is learned from the views, then the depth sensor's error, then the lens again with the corrected depths.
    Each point is refined by the views near its keyframe. Those of the `sharp` views that are no keyframes, the
    supporting ones, add their features to the keyframe nearest to them.
    """
    rows = sorted(views)
    poses = [views[row].world_from_camera for row in rows]
    near = {row: [rows[i] for i in nearby_views(views[row].world_from_camera, poses)] for row in rows}
    keyframe_views = [views[row] for row in keyframes]
    seen_by = [[views[other] for other in near[row]] for row in keyframes]
    lens = learn_lens(views, keyframes, camera, extractor, executor, progress)
    seen_through = camera if lens is None else lens.of(camera)
    if has_sensor:
        response = learn_depth_response(keyframe_views, seen_by, seen_through, extractor, executor, progress)
        views = {row: corrected(view, response, seen_through) for row, view in views.items()}
    if lens is not None:
        lens = learn_lens(views, keyframes, camera, extractor, executor, progress) or lens
        camera = lens.of(camera)
    supporting = sorted(set(sharp) - set(keyframes))

    def refine(row: int) -> MapPoints:
        others = [views[other] for other in near[row]]
        return refined_points(views[row], others, camera, extractor.ratio, extractor.binary)

    refined = [*keyframes, *supporting]
    points = dict(zip(refined, map_in_order(executor, refine, refined, "refine", progress), strict=True))
    offered: dict[int, list[MapPoints]] = {row: [] for row in keyframes}
    keyframe_poses = [view.world_from_camera for view in keyframe_views]
    for row in supporting:
        nearest = nearest_keyframe(views[row].world_from_camera, keyframe_poses)
        if nearest is not None:
            offered[keyframes[nearest]].append(points[row])

    def complete(row: int) -> MapPoints:
        own, pose = points[row], views[row].world_from_camera
        return with_supporting_features(own, offered[row], pose, camera, extractor.binary)

    all_points = list(map_in_order(executor, complete, keyframes, "add_features", progress))
    return RefinedScan(all_points, camera, 0.0 if lens is None else lens.sigma)
