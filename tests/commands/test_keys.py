"""`roomfix keys`, and whether a server starts without any key."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from app.commands.keys import app, duration_s
from app.commands.serve import check_access
from app.errors import InvalidInputError
from app.services.keys.caller import OPEN
from app.services.keys.key_service import key_service
from app.settings import Settings
from app.storage.audit import list_acts
from app.storage.db import Database
from app.storage.venues import create_venue


def run(data_dir: Path, *words: str) -> str:
    """Run a command and return its standard output."""
    result = CliRunner().invoke(app, [*words, "--data-dir", str(data_dir)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def settings(data_dir: Path, **values: object) -> Settings:
    return Settings(_env_file=None, data_dir=data_dir, **values)  # type: ignore[arg-type]


@pytest.fixture(autouse=True)
def _no_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ROOMFIX_ADMIN_KEY", "ROOMFIX_OPEN"):
        monkeypatch.delenv(name, raising=False)


def test_a_key_is_made_listed_and_revoked(tmp_path: Path) -> None:
    with key_service(settings(tmp_path)) as keys:
        database = keys._database
        with database.write() as connection:
            create_venue(connection, "museum", "Museum")
    words = ("--name", "App", "--scope", "locate", "--venue", "museum", "--expires", "30d")
    # Nothing but the key, so that a script can take it.
    text = run(tmp_path, "create", *words).strip()
    with key_service(settings(tmp_path)) as keys:
        caller = keys.identify(text)
        assert (caller.scope, caller.venue_id) == ("locate", "museum")
    listed = run(tmp_path, "list")
    assert "App" in listed
    assert "until" in listed
    assert text not in listed
    run(tmp_path, "revoke", str(caller.key_id))
    assert "revoked" in run(tmp_path, "list")
    opened = Database(f"sqlite:///{tmp_path / 'roomfix.db'}")
    with opened.read() as connection:
        acts = [entry.act for entry in list_acts(connection)]
    opened.close()
    assert [(act.act, act.target, act.venue_id) for act in acts] == [
        ("roomfix keys revoke", caller.key_id, "museum"),
        ("roomfix keys create", caller.key_id, "museum"),
    ]


@pytest.mark.parametrize(("text", "seconds"), [("45m", 2700), ("12h", 43_200), ("30d", 2_592_000)])
def test_a_duration_is_read(text: str, seconds: float) -> None:
    assert duration_s(text) == seconds


@pytest.mark.parametrize("text", ["30", "d", "1w", "-1d", "1.5h", ""])
def test_a_duration_without_a_unit_is_refused(text: str) -> None:
    with pytest.raises(InvalidInputError, match="30d"):
        duration_s(text)


def test_a_server_starts_only_with_a_key_or_open(tmp_path: Path) -> None:
    with pytest.raises(typer.BadParameter, match="roomfix keys create"):
        check_access(settings(tmp_path))
    check_access(settings(tmp_path, admin_key="bootstrap"))
    check_access(settings(tmp_path, open=True))
    with pytest.raises(typer.BadParameter, match="loopback"):
        check_access(settings(tmp_path, open=True, host="0.0.0.0"))
    with key_service(settings(tmp_path)) as keys:
        made = keys.create(OPEN, "operator", "admin")
    check_access(settings(tmp_path))
    with key_service(settings(tmp_path)) as keys:
        keys.revoke(OPEN, made.key.id)
    with pytest.raises(typer.BadParameter, match="no key yet"):
        check_access(settings(tmp_path))
