"""A pose that only few features speak for must not be one that the rest of the picture speaks against."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.mapping.options import parse_build_options
from app.engine.maps.artifact import MapArtifact
from app.engine.maps.open_map import OpenMap
from app.engine.query.attempt.few_inliers import OPTIONS, looks_otherwise, speaks_against
from app.engine.query.localizer import Localizer
from app.engine.query.query import Query
from app.engine.query.second.agreement import Agreement
from app.engine.query.second.look import SecondMatcher
from app.engine.query.settings import LocalizerSettings
from tests.engine.query.test_second_look import SEEN_FROM, built
from tests.rendered_maps import models
from tests.scenes import CAMERA, Room


@pytest.fixture(scope="module")
def whole(room: Room, tmp_path_factory: pytest.TempPathFactory) -> OpenMap:
    """A map with second features."""
    made = built(tmp_path_factory.mktemp("scan"), room, parse_build_options({}))
    return OpenMap.of(made.artifact, made.index, models())


@pytest.fixture(scope="module")
def opened(whole: OpenMap) -> OpenMap:
    """A map with second features and few of its own."""
    return OpenMap.of(of_part(whole.artifact), whole.index, models())


def of_part(artifact: MapArtifact) -> MapArtifact:
    """Return a map whose own features are far below the room and look like nothing, but for a few."""
    arrays = artifact.arrays
    kept = np.zeros(len(arrays.points_in_world), np.bool_)
    kept[kept_rows(artifact)] = True
    points = np.where(
        kept[:, None], arrays.points_in_world, arrays.points_in_world - np.array([0, 0, 50], np.float32)
    )
    noise = (
        np.random.default_rng(0).integers(0, 255, arrays.descriptors.shape).astype(arrays.descriptors.dtype)
    )
    descriptors = np.where(kept[:, None], arrays.descriptors, noise)
    return replace(
        artifact, arrays=replace(arrays, points_in_world=points, descriptors=descriptors), places=None
    )


def kept_rows(artifact: MapArtifact) -> NDArray[np.intp]:
    """Return the rows of a few features of the keyframe next to `SEEN_FROM`, all over the picture."""
    span = artifact.rows(
        int(np.argmin(np.linalg.norm(artifact.arrays.positions - SEEN_FROM.translation, axis=1)))
    )
    return np.arange(span.start, span.stop)[:: (span.stop - span.start) // 24]


@pytest.fixture(scope="module")
def otherwise(opened: OpenMap) -> OpenMap:
    """The same map, whose second features look like others than are there."""
    return of_other_looks(opened)


def of_other_looks(opened: OpenMap) -> OpenMap:
    """Return a map with the second features' descriptors shuffled."""
    second = opened.artifact.second
    assert second is not None
    shuffled = np.random.default_rng(0).permutation(second.descriptors)
    artifact = replace(opened.artifact, second=replace(second, descriptors=shuffled))
    return OpenMap.of(artifact, opened.index, models())


def test_a_pose_of_few_inliers_is_an_answer_where_the_picture_looks_like_it(
    opened: OpenMap, room: Room
) -> None:
    found = Localizer(opened).localize(room.view(SEEN_FROM).rgb, CAMERA)
    assert found.world_from_camera is not None
    assert np.linalg.norm(found.world_from_camera.translation - SEEN_FROM.translation) < 0.05
    assert found.evidence.inliers < OPTIONS.max_inliers


def test_a_pose_of_few_inliers_is_refused_where_the_picture_looks_otherwise(
    otherwise: OpenMap, room: Room
) -> None:
    picture = room.view(SEEN_FROM).rgb
    found = Localizer(otherwise).localize(picture, CAMERA)
    assert (found.world_from_camera, found.reason) == (None, "too_few_inliers")
    # Nothing else refuses it: frames of a session are not compared.
    once = Localizer(otherwise, LocalizerSettings(second_look=False)).localize(picture, CAMERA)
    assert once.world_from_camera is not None


def test_a_pose_of_many_inliers_is_not_compared(whole: OpenMap, room: Room) -> None:
    found = Localizer(of_other_looks(whole)).localize(room.view(SEEN_FROM).rgb, CAMERA)
    assert found.world_from_camera is not None
    assert found.evidence.inliers > OPTIONS.max_inliers


def test_maps_without_second_features_are_not_compared(
    opened: OpenMap, otherwise: OpenMap, room: Room
) -> None:
    query = Query.of(room.view(SEEN_FROM).rgb, CAMERA)

    def refused(tried: OpenMap) -> bool:
        localizer = Localizer(tried)
        return looks_otherwise(localizer.search, localizer.matcher_of(query), SEEN_FROM, CAMERA)

    assert refused(otherwise)
    assert not refused(opened)
    assert not refused(OpenMap.of(replace(otherwise.artifact, second=None), otherwise.index, models()))


def test_a_second_look_compares_itself(otherwise: OpenMap, room: Room) -> None:
    localizer, query = Localizer(otherwise), Query.of(room.view(SEEN_FROM).rgb, CAMERA)
    assert otherwise.second_look is not None
    second = SecondMatcher(query, otherwise, localizer.matcher_of(query), otherwise.second_look)
    assert not looks_otherwise(localizer.search, second, SEEN_FROM, CAMERA)


@pytest.mark.parametrize(
    ("agreement", "is_refused"),
    [
        (Agreement(agreeing=5, disagreeing=3), True),
        (Agreement(agreeing=6, disagreeing=3), False),
        (Agreement(agreeing=6, disagreeing=4), True),
        # Much of the picture agrees, and much is hidden.
        (Agreement(agreeing=7, disagreeing=9), False),
        # A plain wall shows little of either.
        (Agreement(), False),
    ],
    ids=str,
)
def test_much_must_disagree_and_little_agree(agreement: Agreement, is_refused: bool) -> None:
    assert speaks_against(agreement) == is_refused
