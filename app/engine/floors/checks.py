"""Checks of links against the other features: named landmarks and floors exist, and both ends touch something."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely  # type: ignore[import-untyped]

from app.engine.floors.model import FloorFeatures, Landmark, Link
from app.engine.floors.options import OPTIONS
from app.engine.floors.sentences import listed, short
from app.errors import InvalidInputError


def check_links(features: FloorFeatures, floor_ids: Sequence[str]) -> None:
    """Raise `InvalidInputError` for a link with an end that touches nothing, an unknown landmark or floor."""
    for link in features.links:
        if link.to_floor is not None and link.to_floor not in floor_ids:
            raise InvalidInputError(
                f"Link {short(link.id)}: the venue has no floor {short(link.to_floor)} to lead to; it has "
                f"{listed(floor_ids)}. Add that floor first."
            )
        _check_named_ends(link, features)
    _check_touching(features)


def _check_named_ends(link: Link, features: FloorFeatures) -> None:
    ends = [("from", "starts", link.start, 0)]
    if link.to_floor is None:
        ends.append(("to", "ends", link.end, -1))
    for key, verb, landmark_id, position in ends:
        if landmark_id is None:
            continue
        landmark = named_point(features, landmark_id)
        if landmark is None:
            raise InvalidInputError(
                f"Link {short(link.id)}: {key} names {short(landmark_id)}, which is no landmark or poi here."
            )
        x, y = link.points[position]
        away_m = float(np.hypot(landmark.x - x, landmark.y - y))
        if away_m > OPTIONS.touch_m:
            raise InvalidInputError(
                f"Link {short(link.id)} {verb} {away_m:.1f} m away from {short(landmark_id)}, its {key}; "
                f"{OPTIONS.touch_m} m is the most."
            )


def named_point(features: FloorFeatures, landmark_id: str) -> Landmark | None:
    """Return the landmark or POI of an id."""
    return features.landmarks.get(landmark_id) or features.pois.get(landmark_id)


def _check_touching(features: FloorFeatures) -> None:
    """Raise for the first end that touches no landmark, POI or other link."""
    marks = [shapely.Point(m.x, m.y) for group in (features.landmarks, features.pois) for m in group.values()]
    lines = [footprint(link) for link in features.links]
    owners, ends = [], []
    for index, link in enumerate(features.links):
        for position in (0,) if link.to_floor is not None else (0, -1):
            owners.append(index)
            ends.append(link.points[position])
    if not ends:
        return
    touching = np.zeros(len(ends), dtype=bool)
    points = shapely.points(np.array(ends))
    tree = shapely.STRtree([*lines, *marks])
    found_ends, found = tree.query(points, predicate="dwithin", distance=OPTIONS.touch_m)
    touching[found_ends[found != np.array(owners)[found_ends]]] = True
    if not touching.all():
        loose = int(np.flatnonzero(~touching)[0])
        x, y = ends[loose]
        raise InvalidInputError(
            f"Link {short(features.links[owners[loose]].id)} dangles: nothing lies within {OPTIONS.touch_m} m of its "
            f"end at ({x:.2f}, {y:.2f}). Put a landmark there, or lead it to another link."
        )


def footprint(link: Link) -> shapely.Geometry:
    """Return the part of a link on its own floor: its line, or the first point of a way between floors."""
    return shapely.LineString(link.points) if link.to_floor is None else shapely.Point(link.points[0])
