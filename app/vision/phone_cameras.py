"""The main cameras of common phones, by the names that EXIF gives them.

`phone_cameras.csv` holds published values: the focal length of the main camera in a photo's EXIF, and its 35 mm
equivalent. The latter is rounded to whole millimetres, and some makers measure it along the diagonal, others along the
width, so its error is about 5 %: enough to start a search. A model name that ends in `*` stands for all models that
begin with it (Samsung adds a letter for the region).
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files


@dataclass(frozen=True, slots=True)
class PhoneCamera:
    """A phone's main camera: focal length in millimetres where it is known, and its 35 mm equivalent."""

    make: str
    model: str
    focal_mm: float | None
    focal_35mm: float


def find_phone(make: str, model: str) -> PhoneCamera | None:
    """Return the main camera of a phone by EXIF's make and model, or None for one that is not listed."""
    name = _key(make), _key(model)
    exact, beginnings = _phones()
    if name in exact:
        return exact[name]
    return next(
        (p for p in beginnings if name[0] == _key(p.make) and name[1].startswith(_key(p.model))), None
    )


def list_phones() -> tuple[PhoneCamera, ...]:
    """Return all phones of the list."""
    exact, beginnings = _phones()
    return (*exact.values(), *beginnings)


@lru_cache(maxsize=1)
def _phones() -> tuple[dict[tuple[str, str], PhoneCamera], tuple[PhoneCamera, ...]]:
    text = files("app.vision").joinpath("phone_cameras.csv").read_text(encoding="utf-8")
    exact, beginnings = {}, []
    for row in csv.DictReader(text.splitlines()):
        focal = row["main_focal_mm"]
        phone = PhoneCamera(
            row["make"],
            row["model"].removesuffix("*"),
            float(focal) if focal else None,
            float(row["main_focal_35mm"]),
        )
        if row["model"].endswith("*"):
            beginnings.append(phone)
        else:
            exact[_key(phone.make), _key(phone.model)] = phone
    return exact, tuple(beginnings)


def _key(name: str) -> str:
    return name.strip().casefold()
