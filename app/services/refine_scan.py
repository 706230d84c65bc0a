"""The points of all keyframes of a scan, by what all its views say together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor

from app.geometry.camera import Camera
from app.services.left_out_frames import nearest_keyframe, with_left_out
from app.services.map_points import MapPoints, View, nearby_views, refined_points
from app.services.progress import Progress, map_in_order
from app.services.sensor_depth import corrected, learn_depth_response
from app.vision.local_features import LocalFeatureExtractor


def refined_scan(
    views: Mapping[int, View],
    keyframes: Sequence[int],
    sharp: Sequence[int],
    camera: Camera,
    extractor: LocalFeatureExtractor,
    executor: Executor,
    progress: Progress,
) -> list[MapPoints]:
    """Return the points of each keyframe; `keyframes` and `sharp` are rows of `views`.

    The sensor is corrected by what the views say about it; each point is refined by the views near its keyframe; and
    the `sharp` views that are no keyframes lend their features to the keyframe nearest to them.
    """
    rows = sorted(views)
    poses = [views[row].world_from_camera for row in rows]
    near = {row: [rows[i] for i in nearby_views(views[row].world_from_camera, poses)] for row in rows}
    seen_by = [[views[other] for other in near[row]] for row in keyframes]
    known = [views[row] for row in keyframes]
    response = learn_depth_response(known, seen_by, camera, extractor, executor, progress)
    views = {row: corrected(view, response, camera) for row, view in views.items()}
    lenders = sorted(set(sharp) - set(keyframes))

    def refine(row: int) -> MapPoints:
        others = [views[other] for other in near[row]]
        return refined_points(views[row], others, camera, extractor.ratio, extractor.binary)

    asked = [*keyframes, *lenders]
    points = dict(zip(asked, map_in_order(executor, refine, asked, "refine", progress), strict=True))
    lent: dict[int, list[MapPoints]] = {row: [] for row in keyframes}
    standing = [views[row].world_from_camera for row in keyframes]
    for row in lenders:
        nearest = nearest_keyframe(views[row].world_from_camera, standing)
        if nearest is not None:
            lent[keyframes[nearest]].append(points[row])
    return [
        with_left_out(points[row], lent[row], views[row].world_from_camera, camera, extractor.binary)
        for row in keyframes
    ]
