"""Matches by XFeat and LighterGlue, for a frame in which the map's own features find too little."""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.open_map import OpenMap, SecondLook
from app.engine.maps.second_features import SecondFeatures
from app.engine.query.localization import leading, votes_of
from app.engine.query.matches import Matches, QueryMatcher, excluded_keyframes
from app.engine.query.query import Query
from app.engine.query.second.agreement import Agreement, agreement_in_map
from app.engine.stage_timer import clock_s
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.learned.lighterglue import PictureFeatures
from app.vision.repetition import PLACE

Rows = NDArray[np.intp]

FITTED = (
    "By hand, on candidates in desk_rs (docs/figures/unseen.md) and of the demonstration's upper corridors in a map "
    "of its ground floor."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class SecondLookOptions:
    """How much of a frame is matched with how much of the map."""

    max_features: int = limit(
        512, "Features of the frame that are matched.", chosen="By hand: bounds the time of the network."
    )
    min_inliers: int = limit(20, "Fewest inliers of a pose.", chosen=FITTED)
    min_coverage: float = limit(
        0.12, "Least share of the image's grid cells that hold inliers.", chosen=FITTED
    )
    min_matches: int = limit(
        20,
        "Fewest features of the frame that match the most similar keyframes; with fewer no pose is looked for.",
        chosen="By hand: as many as a pose needs inliers.",
    )
    min_first_inliers: int = limit(
        8,
        "Fewest inliers of the pose by the most similar keyframes; with fewer no further keyframes are matched.",
        chosen="By hand: less than half of min_inliers.",
    )
    min_first_unrepeated_share: float = limit(
        0.3,
        "Least share of these inliers that are not repeated; with less no further keyframes are matched.",
        chosen="By hand: half of min_unrepeated_share.",
    )
    min_distance_elsewhere: float = limit(
        0.15,
        "A thing is distinct when none of the map's own SIFT features within 8 cm of it is closer than this to a "
        "feature at another place (distance of unit descriptors).",
        chosen="By hand: four fifths of the features of the demonstration's corridors are closer, and a fifth of those "
        "of its rooms.",
    )
    keyframes: int = limit(
        6, "Most similar keyframes that the frame is matched with.", chosen="By hand: bounds the time."
    )
    covisible: int = limit(
        4, "Keyframes that see what the first pose sees, which are matched too.", chosen="By hand, as above."
    )
    look_alikes: int = limit(
        2,
        "Keyframes of other places that look like one of the best two, which are matched too.",
        chosen="By hand, as above.",
    )
    twins: int = limit(
        20,
        "Keyframes of other places, which look most like each of the two that were matched best, whose features are "
        "compared with the inliers'.",
        chosen=FITTED,
    )
    max_similarity_elsewhere: float = limit(
        0.8, "A feature with a larger cosine to one at another place is repeated.", chosen=FITTED
    )
    min_unrepeated_share: float = limit(
        0.6, "Least share of the inliers that are not repeated.", chosen=FITTED
    )
    min_agreeing_cells: int = limit(
        7, "Fewest cells of the picture that look as the pose says.", chosen=FITTED
    )
    max_disagreeing_share: float = limit(
        0.35, "Largest share of cells that do not, of those that do and do not.", chosen=FITTED
    )
    min_clear_cells: int = limit(
        10,
        "Fewest such cells of a picture with few unrepeated inliers (Limits.min_unrepeated_of_clear).",
        chosen="roomfix evaluate-bare-rooms --building 1 --furnished --panoramas 14; "
        "docs/figures/evaluate-bare-rooms.md.",
    )
    max_orientation_sigma_deg: float = limit(
        5.0,
        "Largest standard deviation of the direction, with what the matches leave open of the camera.",
        chosen="By hand: an answer is right within 5 degrees. Of the answers in desk_rs one had 6.4, and was 9 degrees "
        "off.",
    )
    max_rival_balance_ratio: float = limit(
        0.5,
        "Another pose counts when its agreeing cells less the disagreeing ones are more than this share of those of "
        "the best.",
        chosen=FITTED,
    )


OPTIONS = SecondLookOptions()


class SecondMatcher:
    """Matches one query with keyframes by LighterGlue, each keyframe once; otherwise as `QueryMatcher`.

    What speaks against a pose, and what is found at other places too, is still judged by the map's own features, those
    of `first`.
    """

    def __init__(
        self,
        query: Query,
        opened: OpenMap,
        first: QueryMatcher,
        look: SecondLook,
    ) -> None:
        self.query = query
        self._map, self._first, self._network = opened, first, look.network
        started = clock_s()
        found, self._picture = look.extractor.extract_dense(query.gray)
        query.spent_s["describe"] += clock_s() - started
        count = OPTIONS.max_features
        descriptors = np.asarray(found.descriptors[:count], np.float32)
        self._own = PictureFeatures(found.keypoints_px[:count], descriptors, query.size_px)
        self._matches: dict[int, Matches] = {}
        # The keyframes that were matched so far.
        self.matched: Set[int] = self._matches.keys()
        # By keyframe: the row of the map's feature that each feature of the query matches.
        self._map_rows: dict[int, dict[int, int]] = {}
        self._axis_weights = PLACE.axis_weights(opened.artifact.metadata.z_up)
        self._excluded = excluded_keyframes(opened.artifact, query.allowed)

    @property
    def features(self) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """The pixels (n, 2) and unit descriptors (n, d) of the query's features of the map's own kind."""
        return self._first.features

    def match(self, keyframes: Iterable[int]) -> Matches:
        """Return the merged matches with the keyframes among these that were not matched before."""
        new = [keyframe for keyframe in dict.fromkeys(keyframes) if keyframe not in self._matches]
        started = clock_s()
        self._matches.update(zip(new, self._match(new), strict=True))
        self.query.spent_s["match"] += clock_s() - started
        return Matches.merge([self._matches[keyframe] for keyframe in new])

    def unrepeated_count(self, matches: Matches) -> int:
        """Return how many features have a distinct match, among these of this query, whose feature of the map resembles
        none in the keyframes of other places that look most like those that were matched best."""
        matches = matches.take(matches.distinct)
        voted = leading(votes_of(matches, matches))
        twins = self._map.retrieval.look_alikes_of(voted, OPTIONS.twins, self.query.allowed)
        second = self._map.artifact.second
        if second is None or not twins or not len(matches):
            return matches.distinct_count
        rows = np.array(
            [
                self._map_rows[keyframe][row]
                for keyframe, row in zip(matches.keyframes, matches.query_rows, strict=True)
            ]
        )
        repeated = resembles_elsewhere(
            second, rows, second.take(list(dict.fromkeys(twins))), self._axis_weights
        )
        return len(np.unique(matches.query_rows[~repeated]))

    def agreement(self, world_from_camera: Pose, camera: Camera) -> Agreement:
        """Return how far the picture looks as a pose says."""
        return agreement_in_map(self._map, world_from_camera, camera, self._picture, self.query.allowed)

    def _match(self, keyframes: Sequence[int]) -> list[Matches]:
        """Return the matches with each keyframe.

        Whether a match is distinct is judged by the map's own features of the thing that it shows: they resemble
        nothing elsewhere.
        """
        artifact = self._map.artifact
        second = artifact.second
        if second is None or not keyframes:
            return [Matches.none() for _ in keyframes]
        spans = [second.span(keyframe) for keyframe in keyframes]
        cameras = [artifact.camera(keyframe) for keyframe in keyframes]
        found = [
            self._network.match(
                self._own,
                PictureFeatures(
                    second.keypoints_px[span], second.descriptors[span], (camera.width, camera.height)
                ),
            )
            for span, camera in zip(spans, cameras, strict=True)
        ]
        rows = [span.start + b for span, (_, b, _) in zip(spans, found, strict=True)]
        points = second.points_in_world[np.concatenate(rows)].astype(np.float64)
        elsewhere = self._map.surroundings.distance_elsewhere(points, self._excluded)
        ends = np.cumsum([len(each) for each in rows])[:-1]
        matches = []
        for keyframe, own, (a, _, probability), in_world, distinct in zip(
            keyframes,
            rows,
            found,
            np.split(points, ends),
            np.split(elsewhere >= OPTIONS.min_distance_elsewhere, ends),
            strict=True,
        ):
            self._map_rows[keyframe] = dict(zip(a.tolist(), own.tolist(), strict=True))
            matches.append(
                Matches(
                    points_px=self._own.keypoints_px[a].astype(np.float64),
                    points_in_world=in_world,
                    sigma_m=second.point_sigma_m[own].astype(np.float64),
                    query_rows=a,
                    keyframes=np.full(len(a), keyframe, dtype=np.intp),
                    distances=(1.0 - probability).astype(np.float32),
                    distinct=distinct,
                )
            )
        return matches


def resembles_elsewhere(
    second: SecondFeatures, rows: Rows, others: SecondFeatures, axis_weights: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Return which features of a map, by their rows (n,), resemble one of `others` at another place."""
    similar = second.descriptors[rows].astype(np.float32) @ others.descriptors.astype(np.float32).T
    own, there = (each * axis_weights for each in (second.points_in_world[rows], others.points_in_world))
    squares = (own**2).sum(axis=1)[:, None] + (there**2).sum(axis=1) - 2.0 * own @ there.T
    elsewhere = squares > PLACE.radius_m**2
    return np.asarray(((similar > OPTIONS.max_similarity_elsewhere) & elsewhere).any(axis=1))
