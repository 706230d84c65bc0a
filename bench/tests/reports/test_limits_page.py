"""docs/limits.md is what the code says, and the generator sees every limit."""

from __future__ import annotations

import ast
from dataclasses import dataclass

from app.limits import limit, limits_of
from app.settings import Settings
from bench.commands.limits import PAGE
from bench.reports import limits_page
from bench.reports.limits_page import Holder, limit_holders, settings_of_limits
from tests.source_tree import modules_of


def test_the_page_is_what_would_be_generated() -> None:
    assert PAGE.read_text(encoding="utf-8") == limits_page.limits_page(), "run: roomfix limits"


def test_every_call_of_limit_in_the_code_is_on_the_page() -> None:
    calls = {
        name: sum(
            isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "limit"
            for node in ast.walk(ast.parse(module.path.read_text(encoding="utf-8")))
        )
        for name, module in modules_of("app").items()
        if "app.limits.limit" in module.imports
    }
    shown: dict[str, int] = dict.fromkeys(calls, 0)
    for holder in limit_holders():
        shown[holder.module] += len(holder.limits)
    assert shown == calls


def test_limits_say_what_they_mean_and_how_they_were_chosen() -> None:
    for holder in limit_holders():
        for row in holder.limits:
            assert row.meaning.endswith((".", ")")), f"{holder.name}.{row.name}"
            assert row.chosen.startswith("By hand") or len(row.chosen) > 10, f"{holder.name}.{row.name}"


def test_every_setting_that_replaces_a_limit_is_shown_beside_it() -> None:
    known = {f"{each.module}.{each.name}.{row.name}" for each in limit_holders() for row in each.limits}
    assert set(settings_of_limits()) <= known
    replacing = {
        f"ROOMFIX_{name.upper()}"
        for name, field in Settings.model_fields.items()
        if "docs/limits.md" in (field.description or "")
    }
    assert replacing
    assert set(settings_of_limits().values()) == replacing


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """As a room of the engine has them."""

    error_px: float = limit(1.23456789, "Largest | error.", chosen="A test, docs/figures/track.md.")
    plain: int = 3


def test_a_table_shows_default_meaning_choice_and_setting() -> None:
    holder = Holder("app.engine.query.vdm.lines", "Options", tuple(limits_of(Options)))
    assert holder.room == "app/engine/query"
    table = limits_page._table(
        holder.room, [holder], {"app.engine.query.vdm.lines.Options.error_px": "ROOMFIX_ERROR_PX"}
    )
    assert table.splitlines() == [
        "## app/engine/query",
        "",
        "| limit | default | meaning | how chosen | setting |",
        "| --- | --- | --- | --- | --- |",
        "| `Options.error_px` | `1.23457` | Largest \\| error. | A test, [figures/track.md](figures/track.md). "
        "| `ROOMFIX_ERROR_PX` |",
    ]
    assert Holder("app.vision.matching", "Options", ()).room == "app/vision"
