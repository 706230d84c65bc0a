"""The rule that selects a scan's keyframes and its thresholds, parsed and validated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from app.engine.mapping.option_values import choice, count, flag, number
from app.errors import InvalidInputError
from app.limits import limit
from app.vision.content_keyframes import ALPHA, BETA, ContentRule
from app.vision.keyframes import WANTED_MATCHES, PoseThresholds, thresholds_for_matches

RuleName = Literal["pose", "content", "distance", "interval"]
# The options of each rule.
KEYS: dict[str, tuple[str, ...]] = {
    "pose": ("position_m", "attitude_rad", "thresholds", "wanted_matches"),
    "content": ("alpha", "beta", "combine", "seen", "steady"),
    "distance": ("every_m",),
    "interval": ("every",),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyframeRuleOptions:
    """Defaults of the rules, and the range of a request's values."""

    every_m: float = limit(
        0.5,
        "Default distance between the keyframes of the rule `distance`.",
        chosen="By hand; compared with other rules by `roomfix keyframes ... --rule distance` "
        "(docs/visual-depth-map.md).",
    )
    every_frames: int = limit(
        1,
        "Default number of frames from one keyframe to the next by the rule `interval`.",
        chosen="By hand: every frame.",
    )
    min_wanted_matches: float = limit(
        4.0,
        "Least number of matches that a calibration can be asked for.",
        chosen="By hand: a pose by EPnP needs four matches.",
    )
    max_wanted_matches: float = limit(
        5000.0,
        "Largest number of matches that a calibration can be asked for.",
        chosen="By hand: more than any method has features.",
    )


OPTIONS = KeyframeRuleOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyframeRule:
    """Which frames become keyframes.

    `pose`: a frame that is close to no earlier keyframe, that is, within both `thresholds` (A 2.1). With `calibrated`
    these are fitted to the scan itself, so that `wanted_matches` are left at them. `content`: a frame whose image
    differs from those of the last two keyframes (B eq. 6). `distance`: one frame every `every_m` metres (B eq. 1).
    `interval`: every n-th frame.
    """

    rule: RuleName = "pose"
    thresholds: PoseThresholds = thresholds_for_matches()
    every: int = OPTIONS.every_frames
    calibrated: bool = False
    wanted_matches: float = WANTED_MATCHES
    content: ContentRule = ContentRule()
    every_m: float = OPTIONS.every_m


def parse_keyframe_rule(value: object) -> KeyframeRule:
    """Return the rule of a JSON object; raises `InvalidInputError` with a sentence that names the option."""
    if value is None:
        return KeyframeRule()
    if not isinstance(value, Mapping):
        raise InvalidInputError('keyframes must be an object such as {"rule": "pose"}.')
    known = {"rule", *(key for keys in KEYS.values() for key in keys)}
    unknown = sorted(str(key) for key in set(value) - known)
    if unknown:
        raise InvalidInputError(
            f"Option keyframes.{unknown[0]} is not known; there are {', '.join(sorted(known))}."
        )
    rule = choice(value, "rule", tuple(KEYS), "pose")
    foreign = sorted(set(value) - {"rule", *KEYS[rule]})
    if foreign:
        raise InvalidInputError(
            f"keyframes.{foreign[0]} does not belong to the rule {rule}, which takes {', '.join(KEYS[rule])}."
        )
    if rule == "interval":
        every = count(value.get("every", OPTIONS.every_frames), "keyframes.every", 1, "frames")
        return KeyframeRule(rule="interval", every=every)
    if rule == "distance":
        return KeyframeRule(rule="distance", every_m=_every_m(value))
    if rule == "content":
        return KeyframeRule(rule="content", content=_content(value))
    return _pose_rule(value)


def _every_m(value: Mapping[str, Any]) -> float:
    every_m = number(value.get("every_m", OPTIONS.every_m), "keyframes.every_m")
    if every_m is None or every_m <= 0:
        raise InvalidInputError("keyframes.every_m must be above zero, in metres.")
    return every_m


def _content(value: Mapping[str, Any]) -> ContentRule:
    alpha = number(value.get("alpha", ALPHA), "keyframes.alpha")
    beta = number(value.get("beta", BETA), "keyframes.beta")
    if alpha is None or beta is None or not (0 < alpha < 1 and 0 < beta < 1):
        raise InvalidInputError("keyframes.alpha and keyframes.beta are similarities, between 0 and 1.")
    if beta > alpha:
        raise InvalidInputError(
            "keyframes.beta must not be above keyframes.alpha: the keyframe before the last one is the less similar."
        )
    combine, seen = (
        choice(value, "combine", ("and", "or"), "and"),
        choice(value, "seen", ("skip", "join"), "skip"),
    )
    return ContentRule(alpha, beta, combine, seen, flag(value, "steady", True))  # type: ignore[arg-type]


def _pose_rule(value: Mapping[str, Any]) -> KeyframeRule:
    calibrated, wanted = _calibration(value)
    default = thresholds_for_matches()
    position = number(value.get("position_m"), "keyframes.position_m")
    attitude = number(value.get("attitude_rad"), "keyframes.attitude_rad")
    thresholds = PoseThresholds(
        default.position_m if position is None else position,
        default.attitude_rad if attitude is None else attitude,
    )
    if min(thresholds.position_m, thresholds.attitude_rad) <= 0:
        raise InvalidInputError("keyframes.position_m and keyframes.attitude_rad must be above zero.")
    return KeyframeRule(rule="pose", thresholds=thresholds, calibrated=calibrated, wanted_matches=wanted)


def _calibration(value: Mapping[str, Any]) -> tuple[bool, float]:
    """Return whether the thresholds are to be calibrated, and for what number of matches."""
    if value.get("thresholds", "calibrated") != "calibrated":
        raise InvalidInputError(
            'keyframes.thresholds takes "calibrated"; numbers go into keyframes.position_m and keyframes.attitude_rad.'
        )
    calibrated = "thresholds" in value
    if calibrated and not {"position_m", "attitude_rad"}.isdisjoint(value):
        raise InvalidInputError(
            "keyframes.thresholds: calibrated thresholds leave no room for position_m or attitude_rad."
        )
    given = number(value.get("wanted_matches"), "keyframes.wanted_matches")
    return calibrated, check_wanted_matches(WANTED_MATCHES if given is None else given)


def check_wanted_matches(wanted: float) -> float:
    """Return the number of matches; raises `InvalidInputError` when it is out of range."""
    least, most = OPTIONS.min_wanted_matches, OPTIONS.max_wanted_matches
    if not least <= wanted <= most:
        raise InvalidInputError(f"keyframes.wanted_matches must be between {least:g} and {most:g}.")
    return wanted
