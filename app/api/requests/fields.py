"""How long and how large the values of request fields may be, where only the request limits them."""

from __future__ import annotations

from dataclasses import dataclass

from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldOptions:
    """Bounds of request fields."""

    max_name_characters: int = limit(
        200, "Longest name of a venue or floor.", chosen="By hand: pages and plans show names on one line."
    )
    max_place_characters: int = limit(
        300,
        "Longest text that names a place of a route.",
        chosen="By hand: longer than any id or `floor:x,y`.",
    )
    max_destination_characters: int = limit(
        200, "Longest destination of a session.", chosen="By hand: longer than any id or `floor:x,y`."
    )
    max_language_characters: int = limit(
        35, "Longest language tag.", chosen="RFC 5646, section 4.4.1: room for every registered subtag."
    )
    max_avoided: int = limit(
        20, "Largest number of values of `avoid`.", chosen="By hand: more than there are kinds of links."
    )
    max_heading_deg: float = limit(
        720.0,
        "Largest absolute heading.",
        chosen="By hand: angles that were added up once too often are taken.",
    )
    min_height_m: float = limit(
        -1000.0,
        "Lowest height of a venue's origin above the ellipsoid.",
        chosen="By hand: below every shore; the ellipsoid lies at most about 110 m above the sea.",
    )
    max_height_m: float = limit(
        10_000.0, "Largest height of a venue's origin.", chosen="By hand: above every mountain."
    )
    max_latitude_deg: float = limit(
        89.0,
        "Largest absolute latitude of a venue's origin.",
        chosen="By hand: nearer to a pole east and north turn within a building; nobody builds there.",
    )
    max_key_expiry_s: float = limit(
        3.2e9,
        "Longest life of a key that expires.",
        chosen="By hand: a hundred years; a key that is meant to last has no expiry.",
    )
    min_level: int = limit(-100, "Lowest level of a floor.", chosen="By hand: below every building's.")
    max_level: int = limit(1000, "Highest level of a floor.", chosen="By hand: above every building's.")
    max_pois: int = limit(
        50, "Largest number of POIs of an anchor.", chosen="By hand: a picture has room for fewer."
    )
    max_region_corners: int = limit(
        50,
        "Largest number of corners of a POI's region.",
        chosen="By hand: outlines that people draw have fewer.",
    )


FIELDS = FieldOptions()
# Of a name that shows something.
NAME_PATTERN = r"\S"
NAME_IN_WORDS = "A name has at least one character that is not a space"
