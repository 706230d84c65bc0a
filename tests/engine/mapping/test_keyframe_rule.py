"""The options of keyframe rules, uniform motion and map size: what is understood, and what is refused."""

from __future__ import annotations

from typing import Any

import pytest

from app.engine.mapping.keyframe_rule import KeyframeRule, parse_keyframe_rule
from app.engine.mapping.options import parse_build_options
from app.errors import InvalidInputError
from app.geometry.uniform_motion import UniformMotion
from app.vision.content_keyframes import ContentRule

MOTION = {"start": [1, 2, 1.5], "speed_m_s": 0.8, "direction_deg": 90, "fps": 30}


def test_every_rule_is_understood() -> None:
    assert parse_keyframe_rule(None) == KeyframeRule()
    assert parse_keyframe_rule({"rule": "content"}).content == ContentRule(0.35, 0.2, "and", "skip")
    given = {"rule": "content", "alpha": 0.4, "beta": 0.3, "combine": "or", "seen": "join", "steady": False}
    assert parse_keyframe_rule(given).content == ContentRule(0.4, 0.3, "or", "join", False)
    assert parse_keyframe_rule({"rule": "distance"}).every_m == 0.5
    assert parse_keyframe_rule({"rule": "distance", "every_m": 2}).every_m == 2.0
    assert parse_keyframe_rule({"rule": "interval", "every": 10}).every == 10


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ({"rule": "content", "alpha": 1.5}, "alpha"),
        ({"rule": "content", "alpha": None}, "alpha"),
        ({"rule": "content", "beta": 0}, "beta"),
        ({"rule": "content", "alpha": 0.2, "beta": 0.3}, "beta must not be above"),
        ({"rule": "content", "alpha": "much"}, "finite number"),
        ({"rule": "content", "combine": "xor"}, "and, or"),
        ({"rule": "content", "seen": 3}, "skip, join"),
        ({"rule": "content", "steady": "yes"}, "true or false"),
        ({"rule": "content", "every": 3}, "does not belong"),
        ({"rule": "distance", "every_m": 0}, "every_m"),
        ({"rule": "distance", "every_m": -1}, "every_m"),
        ({"rule": "distance", "every_m": True}, "finite number"),
        ({"rule": "distance", "alpha": 0.3}, "does not belong"),
        ({"rule": "interval", "every": 2.5}, "whole number"),
        ({"rule": "magic"}, "content"),
        ({"rule": ["content"]}, "must be one of"),
        ({"how": 1}, "not known"),
        ([], "must be an object"),
    ],
)
def test_what_a_rule_cannot_mean_is_refused(value: Any, says: str) -> None:
    with pytest.raises(InvalidInputError, match=says):
        parse_keyframe_rule(value)


def test_uniform_motion_is_all_four_options() -> None:
    assert parse_build_options(MOTION).scan.motion == UniformMotion((1.0, 2.0, 1.5), 0.8, 90.0, 30.0)
    assert parse_build_options({}).scan.motion is None


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"fps": None}, "needs fps too"),
        ({"start": [0, 0]}, "three numbers"),
        ({"start": "here"}, "three numbers"),
        ({"start": [0, 0, "eye"]}, "finite number"),
        ({"start": [0, 0, None]}, "numbers"),
        ({"speed_m_s": -1}, "speed_m_s"),
        ({"fps": 0}, "fps"),
        ({"direction_deg": "north"}, "direction_deg"),
        ({"gravity": [0, 0, -1]}, "upright"),
    ],
)
def test_a_motion_that_cannot_be_meant_is_refused(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(InvalidInputError, match=says):
        parse_build_options({**MOTION, **changes})


@pytest.mark.parametrize("value", [0, 49, 1.5, "many", True, 1e400])
def test_a_keyframe_keeps_at_least_fifty_features(value: Any) -> None:
    with pytest.raises(InvalidInputError, match="max_features_per_keyframe"):
        parse_build_options({"max_features_per_keyframe": value})
    assert parse_build_options({"max_features_per_keyframe": 50}).max_features_per_keyframe == 50
