"""The matches that an answer of /locate shows: the same points in the photo and in the keyframe's picture."""

from __future__ import annotations

import numpy as np

from tests.scenes import CAMERA, CAMERA_TEXT, View
from tests.server import Server, assert_problem


def test_pairs_show_the_same_points(museum: Server, queries: list[View], views: list[View]) -> None:
    query = queries[1]
    answer = museum.locate(query.jpeg(), venue="museum", matches="true")
    assert answer["located"]
    keyframe, pairs = answer["shown_matches"]["keyframe"], np.array(answer["shown_matches"]["pairs"])
    assert len(pairs) > 10
    assert keyframe == answer["keyframes"][0]["keyframe"]
    assert len(pairs) >= answer["keyframes"][0]["inliers"] - 1
    (described,) = [
        each
        for each in museum.client.get("/venues/museum/maps/1/keyframes").json()
        if each["keyframe"] == keyframe
    ]
    view = views[round(described["time_s"] * 10)]
    u, v = np.round(pairs[:, :2]).astype(int).T
    points = CAMERA.unproject(pairs[:, :2], query.depth_m[v, u])
    in_keyframe = view.world_from_camera.inverse().apply(query.world_from_camera.apply(points))
    errors = np.linalg.norm(CAMERA.project(in_keyframe) - pairs[:, 2:], axis=1)
    assert np.median(errors) < 2.0


def test_no_pairs_are_shown_unasked_or_without_a_pose(museum: Server, queries: list[View]) -> None:
    assert museum.locate(queries[1].jpeg(), venue="museum")["shown_matches"] is None
    dark = View(queries[1].world_from_camera, np.zeros_like(queries[1].rgb), queries[1].depth_m)
    assert museum.locate(dark.jpeg(), venue="museum", matches="true")["shown_matches"] is None


def test_an_image_that_gravity_turns_shows_none(museum: Server, queries: list[View]) -> None:
    turned = np.ascontiguousarray(np.rot90(queries[1].rgb))
    view = View(queries[1].world_from_camera, turned, queries[1].depth_m)
    fx, fy, cx, cy = CAMERA.params[:4]
    camera = f"{fy},{fx},{cy},{CAMERA.width - 1 - cx}"
    answer = museum.locate(view.jpeg(), venue="museum", matches="true", camera=camera, gravity="1,0,0")
    assert answer["shown_matches"] is None


def test_what_is_no_yes_or_no_is_refused(museum: Server, queries: list[View]) -> None:
    fields = {"venue": "museum", "camera": CAMERA_TEXT, "matches": "some"}
    assert_problem(museum.post_image(queries[1].jpeg(), fields), 422, "invalid_request")
