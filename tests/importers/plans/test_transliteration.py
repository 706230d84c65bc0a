"""Names with letters that ids can't have."""

from __future__ import annotations

import pytest

from app.importers.plans.finish import floor_ids, slug
from app.importers.plans.transliteration import transliterated


@pytest.mark.parametrize(
    ("name", "own"),
    [
        ("Büro Süd", "buero-sued"), ("BÜRO", "buero"), ("Großer Saal", "grosser-saal"), ("Café Señor", "cafe-senor"),
        ("Ærø Ångström", "aeroe-aangstroem"), ("Łódź", "lodz"), ("Bu\u0308ro", "buero"), ("会議室", "place"),
    ],
)  # fmt: skip
def test_an_id_from_a_name_stays_readable(name: str, own: str) -> None:
    assert slug(name) == own


@pytest.mark.parametrize(
    ("name", "category", "own"),
    [
        ("Лестница", "stairs", "stairs"), ("Кабинет 101", "classroom", "classroom-101"), ("会議室", None, "place"),
        ("Туалет женский", "restroom.female", "restroom-female"), ("304", "classroom", "304"),
        ("Зал A", "auditorium", "a"), ("Зал 5", None, "5"),
    ],
)  # fmt: skip
def test_a_name_in_another_script_has_its_category_in_its_id(
    name: str, category: str | None, own: str
) -> None:
    assert slug(name, category) == own


def test_case_and_other_scripts_stay() -> None:
    assert transliterated("Übergang ÜBER 会議室 3") == "Uebergang UeBER 会議室 3"
    assert floor_ids([["Höhe/2"], ["Hoehe-2"]]) == ["Hoehe-2", "Hoehe-2-2"]
