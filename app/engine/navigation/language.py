"""The sentences of steps. `sentences/` has one JSON file for each language; a new file adds a language."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

from app.engine.floors.model import Landmark
from app.engine.floors.sentences import listed, short
from app.engine.navigation.model import Step
from app.errors import InvalidInputError
from app.limits import limit

DEFAULT_LANGUAGE = "en"


@dataclass(frozen=True, slots=True, kw_only=True)
class SentenceOptions:
    """How much a sentence says."""

    max_passing: int = limit(
        2, "Landmarks on the way that one sentence names.", chosen="By hand: nobody keeps more names in mind."
    )
    min_walk_m: float = limit(
        1.0,
        "A step with less than this to walk after it is said without a distance.",
        chosen="By hand: distances are said in whole metres.",
    )


OPTIONS = SentenceOptions()


@lru_cache(maxsize=1)
def catalogues() -> Mapping[str, Mapping[str, str]]:
    """Return the sentences of each language, by its code."""
    folder = files("app.engine.navigation") / "sentences"
    found = {
        entry.name.removesuffix(".json"): json.loads(entry.read_text(encoding="utf-8"))
        for entry in folder.iterdir()
        if entry.name.endswith(".json")
    }
    return dict(sorted(found.items()))


def language_of(asked: str | None, accepted: str | None = None) -> str:
    """Return the language to speak: the one asked for, else the best of an Accept-Language header, else English.

    Regions are ignored: de-AT is de. Raises `InvalidInputError` when the one asked for is not known.
    """
    if asked is not None and asked.strip():
        code = _code(asked)
        if code not in catalogues():
            raise InvalidInputError(
                f"language {short(asked)} is not spoken here; there are {listed([*catalogues()])}."
            )
        return code
    wishes = []
    for position, part in enumerate((accepted or "")[:500].split(",")):
        tag, _, parameters = part.partition(";")
        quality = _quality(parameters)
        # Of quality 0 is what the reader doesn't understand (RFC 9110, section 12.4.2).
        if quality > 0:
            wishes.append((-quality, position, _code(tag)))
    return next((code for _, _, code in sorted(wishes) if code in catalogues()), DEFAULT_LANGUAGE)


def _name(landmark: Landmark | None) -> str | None:
    return None if landmark is None else landmark.name


def _code(tag: str) -> str:
    return tag.strip().lower().replace("_", "-").partition("-")[0]


def _quality(parameters: str) -> float:
    name, _, value = parameters.strip().partition("=")
    try:
        return float(value) if name.strip().lower() == "q" else 1.0
    except ValueError:
        return 0.0


class Speaker:
    """Makes the sentences of one language. `floor_names` are the names of floors by id, as people read them."""

    def __init__(self, language: str, floor_names: Mapping[str, str]) -> None:
        self._words = catalogues()[language]
        self._floor_names = floor_names

    def step(self, step: Step) -> str:
        """Return the sentence of a step with the way that follows it."""
        if step.turn in ("up", "down", "arrive") or step.distance_m < OPTIONS.min_walk_m:
            return self._sentence(self._maneuver(step))
        return self._sentence(self._walk(step, step.distance_m))

    def maneuver(self, step: Step) -> str:
        """Return the sentence of a step without the way that follows it."""
        return self._sentence(self._maneuver(step))

    def walk(self, step: Step, distance_m: float, goal: Step | None = None) -> str:
        """Return the sentence for `distance_m` of way after a step; `goal` is the last step if the way ends there."""
        distance = self._distance(distance_m)
        if goal is not None:
            return self._sentence(self._say("goal", at=_name(goal.at), distance=distance))
        return self._sentence(self._go("walk", step, distance))

    def say(self, key: str) -> str:
        """Return a sentence that belongs to no step."""
        return self._sentence(self._words[key])

    def _maneuver(self, step: Step) -> str:
        if step.to_floor is not None:
            floor = self._floor_names.get(step.to_floor, step.to_floor)
            return self._words[f"{step.mode}.{step.turn}"].format(floor=floor)
        return self._say(step.turn, at=_name(step.at))

    def _walk(self, step: Step, distance_m: float) -> str:
        distance = self._distance(distance_m)
        if step.enters_floor:
            sentence = self._go("walk.floor", step, distance)
        elif step.turn in ("depart", "straight"):
            sentence = self._go("walk" if step.turn == "depart" else "walk.straight", step, distance)
        else:
            sentence = self._go("walk.after", step, distance)
        names = [mark.name for mark in step.passing[-OPTIONS.max_passing :]]
        if not names:
            return sentence
        listing = names[0] if len(names) == 1 else self._words["and"].format(first=names[0], second=names[1])
        return self._words["past"].format(sentence=sentence, names=listing)

    def _go(self, key: str, step: Step, distance: str) -> str:
        floor = self._floor_names.get(step.floor, step.floor)
        turn = "" if step.turn in ("up", "down") else self._maneuver(step)
        key = key if step.towards is None else f"{key}.towards"
        towards = _name(step.towards)
        return self._words[key].format(distance=distance, towards=towards, floor=floor, turn=turn)

    def _say(self, key: str, at: str | None, **values: str) -> str:
        known = at is not None and f"{key}.at" in self._words
        return self._words[f"{key}.at" if known else key].format(at=at, **values)

    def _distance(self, metres: float) -> str:
        return self._words["distance"].format(metres=max(round(metres), 1))

    def _sentence(self, text: str) -> str:
        return self._words["sentence"].format(sentence=text.removesuffix("."))
