"""docs/settings.md lists every setting with its default and its meaning, and no other."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from app.commands.console import settings_from
from app.errors import InvalidInputError
from app.settings import Settings

PAGE = (Path(__file__).parents[1] / "docs" / "settings.md").read_text(encoding="utf-8")
ROWS = [line for line in PAGE.splitlines() if line.startswith("| `ROOMFIX_")]


def row_of(name: str) -> str:
    """Return the row of the table that a setting should have."""
    field = Settings.model_fields[name]
    default = "none" if field.default is None else f"`{str(field.default).lower()}`"
    return f"| `ROOMFIX_{name.upper()}` | {default} | {field.description} |"


@pytest.mark.parametrize("name", Settings.model_fields)
def test_a_setting_has_its_row(name: str) -> None:
    assert Settings.model_fields[name].description
    assert row_of(name) in ROWS


def test_no_row_is_of_a_setting_that_is_gone() -> None:
    named = {re.findall(r"`ROOMFIX_(\w+)`", row)[0].lower() for row in ROWS}
    assert named == set(Settings.model_fields)
    assert len(ROWS) == len(Settings.model_fields)


def test_a_setting_that_can_not_be_used_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROOMFIX_PORT", "http")
    monkeypatch.setenv("ROOMFIX_CORS_ORIGINS", "https://app.example/")
    with pytest.raises(InvalidInputError) as refused:
        settings_from()
    assert "ROOMFIX_PORT: Input should be a valid integer" in str(refused.value)
    assert "ROOMFIX_CORS_ORIGINS: https://app.example/ is no origin" in str(refused.value)
