"""Every call, by HTTP or WebSocket, with every kind of key: just what the table in docs/keys.md says."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.api.key_rows import VENUE, Callers, Row, calls, rows
from tests.server import running

ROWS = rows()
ADMIN_KEY = "the-key-of-the-settings"


@pytest.fixture(scope="module")
def callers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callers]:
    folder = tmp_path_factory.mktemp("matrix")
    limits = {"wrong_keys_per_minute": 0, "calls_per_minute": 0}
    with running(folder, run_worker=False, admin_key=ADMIN_KEY, **limits) as server:
        yield Callers(server, ADMIN_KEY)


def test_the_table_has_a_row_for_every_route_and_no_other(callers: Callers) -> None:
    documented = [row.call for row in ROWS]
    assert sorted(documented) == sorted(calls(callers.client.app))
    assert len(documented) > 40


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.call)
def test_a_call_is_answered_as_the_table_says(callers: Callers, row: Row) -> None:
    expected = {**row.cells, "expired": row.cells["no key"], "revoked": row.cells["no key"]}
    found = {column: outcome(*callers.call(row.call, column), cell) for column, cell in expected.items()}
    assert found == expected


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.call)
def test_a_key_to_record_is_let_in_as_one_to_locate_and_records(callers: Callers, row: Row) -> None:
    expected = "yes" if "/recordings" in row.call else row.cells["locate"]
    assert outcome(*callers.call(row.call, "record"), expected) == expected


def outcome(status: int, body: str, cell: str) -> str:
    """Return what became of a call as the table writes it.

    A call that was let in may still fail for what it holds. A list of a key's own venue names no other one. The 404 of
    a key of another venue says so.
    """
    if status in (401, 403):
        return str(status)
    if cell == "404" and status == 404 and "of this key" in body:
        return "404"
    if cell == "404" and status == 404 and "There is no key" in body:
        return "404"
    if cell == "own":
        return "own" if status == 200 and VENUE not in body else f"{status} {body[:100]}"
    return "yes" if status != 500 else f"500 {body[:100]}"


def test_the_columns_are_told_apart() -> None:
    columns = list(ROWS[0].cells)
    assert columns == ["no key", "locate", "anchor", "admin", "token", "other venue", "other camera"]
    for column in columns[1:]:
        assert any(row.cells[column] != row.cells["no key"] for row in ROWS)
    assert {cell for row in ROWS for cell in row.cells.values()} == {"yes", "own", "401", "403", "404"}
