"""Check, backup and restore, while a server writes to the same data folder."""

from __future__ import annotations

import shutil
import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from app.cli import app
from app.storage.blobs import BlobStore
from app.storage.check import CheckedStore, check_store
from app.storage.db import Database
from tests.scenes import View, scan_files, zipped
from tests.server import QUICK, Server, running

VENUE = "v"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, views: list[View]) -> Iterator[Server]:
    """A server with a map."""
    with running(tmp_path_factory.mktemp("serving")) as server:
        server.add_venue(VENUE)
        server.add_map(zipped(scan_files(views[:4])), VENUE, **QUICK)
        yield server


def run(*arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def checked(folder: Path) -> CheckedStore:
    database = Database(f"sqlite:///{folder / 'roomfix.db'}")
    try:
        return check_store(database, BlobStore.open(None, folder, folder / "cache"), lambda *_: None)
    finally:
        database.close()


def blobs_of(folder: Path) -> list[Path]:
    return sorted(path for path in (folder / "blobs").rglob("*") if path.is_file())


def version_of(folder: Path, view: View) -> int:
    with running(folder, run_worker=False) as again:
        result = again.locate(view.jpeg(), venue=VENUE)
        assert result["located"]
        return int(result["map_version"])


def test_a_backup_is_made_while_edits_go_on_and_serves(
    server: Server, views: list[View], tmp_path: Path
) -> None:
    stop = threading.Event()
    written: list[str] = []

    def edit() -> None:
        while not stop.is_set():
            name = f"edit{len(written)}"
            assert server.client.post("/venues", json={"id": name, "name": name}).status_code == 201
            written.append(name)

    editor = threading.Thread(target=edit)
    editor.start()
    try:
        before = list(written)
        assert run("backup", tmp_path / "backup", "--data-dir", server.data_dir)[0] == 0
    finally:
        stop.set()
        editor.join()
    found = checked(tmp_path / "backup")
    assert (found.findings, found.checked > 2) == ([], True)
    database = sqlite3.connect(tmp_path / "backup" / "roomfix.db")
    venues = {row[0] for row in database.execute("SELECT id FROM venues")}
    database.close()
    assert venues >= {VENUE, *before}
    # A second backup copies the database, and no blob again.
    assert "0 blobs copied" in run("backup", tmp_path / "backup", "--data-dir", server.data_dir)[1]
    # Restored into a new folder, and started on as it is.
    assert run("restore", tmp_path / "backup", "--data-dir", tmp_path / "new")[0] == 0
    assert version_of(tmp_path / "new", views[3]) == 1
    assert version_of(tmp_path / "backup", views[3]) == 1


def test_faults_are_named_and_repaired_from_a_backup(server: Server, tmp_path: Path) -> None:
    folder, copy = tmp_path / "data", tmp_path / "backup"
    assert run("backup", copy, "--data-dir", server.data_dir)[0] == 0
    shutil.copytree(copy, folder)
    assert run("check", "--data-dir", folder)[0] == 0
    damaged, missing = blobs_of(folder)[:2]
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"\0\0")
    missing.unlink()
    code, text = run("check", "--data-dir", folder)
    assert code == 1
    assert f"Blob {damaged.name} is damaged" in text
    assert f"Blob {missing.name} is missing" in text
    assert "roomfix restore" in text
    # What is wrong in the store is not copied over what is right in the backup.
    code, text = run("backup", copy, "--data-dir", folder)
    assert code == 0
    code, text = run("restore", copy, "--data-dir", folder)
    assert (code, "2 blobs copied" in text) == (0, True)
    assert run("check", "--data-dir", folder)[0] == 0
    database = sqlite3.connect(folder / "roomfix.db")
    database.execute("UPDATE venues SET active_map_version = 9 WHERE id = ?", (VENUE,))
    database.commit()
    database.close()
    assert "version 9" in run("check", "--data-dir", folder)[1]


def test_a_running_server_goes_back_to_a_backup(server: Server, views: list[View], tmp_path: Path) -> None:
    assert run("backup", tmp_path / "backup", "--data-dir", server.data_dir)[0] == 0
    server.add_venue("later")
    assert server.client.delete(f"/venues/{VENUE}").status_code == 204
    code, text = run("restore", tmp_path / "backup", "--data-dir", server.data_dir, "--replace")
    assert code == 0, text
    names = {venue["id"] for venue in server.client.get("/venues").json()}
    assert VENUE in names
    assert "later" not in names
    assert server.locate(views[3].jpeg(), venue=VENUE)["map_version"] == 1
    assert checked(server.data_dir).findings == []


def test_a_folder_without_a_backup_is_refused(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["restore", str(tmp_path), "--data-dir", str(tmp_path / "new")])
    assert result.exit_code == 1
    assert "no backup" in str(result.exception)
    assert not (tmp_path / "new" / "roomfix.db").exists()
