"""Pictures localized in the points of a part that other pictures have made."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.loops.measure import OPTIONS as LOOPS
from app.engine.mapping.structure.matches import MatchedPictures, Pair, Rows
from app.engine.mapping.structure.reconstruction import Reconstruction, median_depth
from app.geometry.camera import tangent_of_px
from app.geometry.pnp import estimate_pose_lo_ransac
from app.geometry.se3 import Pose

Array = NDArray[np.float64]
Partners = Mapping[int, list[tuple[int, Rows]]]


@dataclass(frozen=True, slots=True)
class Sighting:
    """The pose of a picture in a part, and the rows (n,) of its features and of the part's points that agree."""

    pose: Pose
    features: Rows
    points: Rows


@dataclass(frozen=True, slots=True)
class PartPoints:
    """A part, its median depth, and the row of the point that each feature of its pictures shows, -1 for none."""

    part: Reconstruction
    point_of: dict[int, Rows]
    median_depth: float

    @staticmethod
    def of(part: Reconstruction, matched: MatchedPictures) -> PartPoints:
        """Return them by the part's observations."""
        point_of = {row: np.full(len(matched.features[row].keypoints_px), -1, np.intp) for row in part.poses}
        order = np.argsort(part.observations[:, 0], kind="stable")
        seen = part.observations[order]
        for row, points in point_of.items():
            first, last = np.searchsorted(seen[:, 0], [row, row + 1])
            points[seen[first:last, 1]] = seen[first:last, 2]
        return PartPoints(part, point_of, median_depth(part))

    def localize(self, row: int, matched: MatchedPictures, partners: Partners) -> Sighting | None:
        """Return where a picture is by the points that its matched pictures in the part show; None where too few
        agree."""
        pairs = self._candidates(row, partners)
        if len(pairs) < LOOPS.min_inliers:
            return None
        found = estimate_pose_lo_ransac(
            matched.features[row].keypoints_px[pairs[:, 0]],
            self.part.points[pairs[:, 1]],
            self.part.camera,
            max_error_px=tangent_of_px(LOOPS.max_error_px) * self.part.camera.focal_px,
        )
        if found is None:
            return None
        inliers = int(found.inlier_mask.sum())
        if inliers < max(LOOPS.min_inliers, LOOPS.min_inlier_share * len(pairs)):
            return None
        features, points = pairs[found.inlier_mask].T
        return Sighting(found.world_from_camera, features, points)

    def depth(self, pose: Pose, points: Rows) -> Array:
        """Return the depths (n,) of points in a camera."""
        return np.asarray(pose.inverse().apply(self.part.points[points])[:, 2])

    def _candidates(self, row: int, partners: Partners) -> NDArray[np.intp]:
        """Return pairs (n, 2), each once, of a feature of the picture and a point that it may show."""
        found = [np.zeros((0, 2), np.intp)]
        for other, rows in partners.get(row, ()):
            known = self.point_of.get(other)
            if known is not None:
                found.append(np.stack([rows[:, 0], known[rows[:, 1]]], axis=1))
        own = self.point_of.get(row)
        if own is not None:
            found.append(np.stack([np.arange(len(own)), own], axis=1))
        pairs = np.concatenate(found)
        return np.asarray(np.unique(pairs[pairs[:, 1] >= 0], axis=0))


def partners_of(matches: Mapping[Pair, Rows]) -> Partners:
    """Return for each picture the pictures that it matches, with the rows of its features and of theirs."""
    found: dict[int, list[tuple[int, Rows]]] = defaultdict(list)
    for (i, j), rows in matches.items():
        found[i].append((j, rows))
        found[j].append((i, rows[:, ::-1]))
    return found
