"""Words of the format that are written and read."""

from __future__ import annotations

VERSION = "1.0.0"
# What the format has no member for stands in a property of this name, in features of archives with this extension.
OWN = "roomfix"
EXTENSION = "imdf:extension:roomfix:links#1.0.0"

# A category of units or relationships -> the mode of a way between levels.
MODES = {
    "stairs": "stairs", "steps": "stairs", "elevator": "lift", "escalator": "escalator", "ramp": "stairs",
    "movingwalkway": "escalator",
}  # fmt: skip
UNIT_MODES = {"stairs": "stairs", "elevator": "lift", "escalator": "escalator"}
CATEGORY_OF_MODE = {
    "walk": "traversal.path",
    "stairs": "stairs",
    "lift": "elevator",
    "escalator": "escalator",
}
# Units that are no rooms but what rooms are made of.
SOLID_UNITS = frozenset({"brick", "column", "concrete", "drywall", "glass", "structure", "wood"})
CLOSED_UNITS = frozenset({"nonpublic", "opentobelow", "vegetation", "fieldofplay"})
# Units that people enter from a neighbour of these categories without a door.
OPEN_UNITS = frozenset(
    {
        "footbridge", "foodservice", "lobby", "lounge", "movingwalkway", "platform", "ramp", "recreation", "road",
        "steps", "terrace", "unenclosedarea", "waitingroom", "walkway", "walkway.island",
    }
)  # fmt: skip
UNIT_CATEGORIES = (
    SOLID_UNITS
    | CLOSED_UNITS
    | OPEN_UNITS
    | set(UNIT_MODES)
    | {
        "auditorium", "classroom", "conferenceroom", "firstaid", "fitnessroom", "huddleroom", "kitchen",
        "laboratory", "library", "mailroom", "mothersroom", "movietheater", "office", "parking", "phoneroom",
        "privatelounge", "restroom", "restroom.family", "restroom.female", "restroom.female.wheelchair",
        "restroom.male", "restroom.male.wheelchair", "restroom.transgender", "restroom.transgender.wheelchair",
        "restroom.unisex", "restroom.unisex.wheelchair", "restroom.wheelchair", "room", "serverroom", "shower",
        "smokingarea", "storage", "theater", "unspecified",
    }
)  # fmt: skip
ENTRANCES = frozenset({"pedestrian.principal", "pedestrian.transit", "emergencyexit"})
FEATURE_TYPES = (
    "address", "amenity", "anchor", "building", "detail", "fixture", "footprint", "geofence", "kiosk", "level",
    "occupant", "opening", "relationship", "section", "unit", "venue",
)  # fmt: skip
