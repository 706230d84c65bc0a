"""What links must fit to: the landmarks that they name, something at each of their ends, floors that exist."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely  # type: ignore[import-untyped]

from app.engine.floors.geometry import short
from app.engine.floors.model import TOUCH_M, FloorFeatures, Landmark, Link
from app.errors import InvalidInputError

MAX_NAMED = 10


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


def listed(names: Sequence[str]) -> str:
    """Return names for a sentence, not more than a few."""
    shown = ", ".join(short(name) for name in names[:MAX_NAMED])
    return f"{shown} and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else shown or "none"


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
        if away_m > TOUCH_M:
            raise InvalidInputError(
                f"Link {short(link.id)} {verb} {away_m:.1f} m away from {short(landmark_id)}, its {key}; "
                f"{TOUCH_M} m is the most."
            )


def named_point(features: FloorFeatures, landmark_id: str) -> Landmark | None:
    """Return the landmark or POI of an id."""
    return features.landmarks.get(landmark_id) or features.pois.get(landmark_id)


def _check_touching(features: FloorFeatures) -> None:
    """Raise for the first end that is farther than `TOUCH_M` from every landmark, POI and other link."""
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
    found_ends, found = tree.query(points, predicate="dwithin", distance=TOUCH_M)
    touching[found_ends[found != np.array(owners)[found_ends]]] = True
    if not touching.all():
        loose = int(np.flatnonzero(~touching)[0])
        x, y = ends[loose]
        raise InvalidInputError(
            f"Link {short(features.links[owners[loose]].id)} dangles: nothing lies within {TOUCH_M} m of its end at "
            f"({x:.2f}, {y:.2f}). Put a landmark there, or lead it to another link."
        )


def footprint(link: Link) -> shapely.Geometry:
    """Return what of a link can be walked on its own floor: its line, or where a way between floors begins."""
    return shapely.LineString(link.points) if link.to_floor is None else shapely.Point(link.points[0])
