"""`roomfix check`, `roomfix backup` and `roomfix restore`: on a data folder, while its server runs or not."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from app.commands.console import DataDir, JsonFlag, console, progress_bars, settings_from
from app.storage.backup import Copied, make_backup, restore_backup, sqlite_path
from app.storage.blobs import BlobStore
from app.storage.check import check_store
from app.storage.db import Database


def check(data_dir: DataDir = None, as_json: JsonFlag = False) -> None:
    """Verify the checksum of every blob and every reference to one, and say how to repair what is wrong."""
    with _store(data_dir) as (database, blobs), progress_bars() as bars:
        found = check_store(database, blobs, lambda done, total: bars.report("check", done, total))
    if as_json:
        faults = [{"what": each.what, "repair": each.repair, "blob": each.blob} for each in found.findings]
        console.print_json(
            json.dumps({"findings": faults, "checked": found.checked, "unreferenced": found.unreferenced})
        )
    else:
        for each in found.findings:
            console.print(f"[red]{each.what}[/red]\n  Repair: {each.repair}", soft_wrap=True)
        console.print(
            f"{found.checked} blobs checked, {len(found.findings)} faults, {found.unreferenced} blobs that nothing "
            "refers to (the sweep deletes them)."
        )
    if found.findings:
        raise typer.Exit(1)


def backup(
    folder: Annotated[
        Path, typer.Argument(help="Folder for the backup; one that holds an earlier backup is updated.")
    ],
    data_dir: DataDir = None,
) -> None:
    """Copy the database and all blobs that it refers to into a folder; the server may run meanwhile."""
    with _store(data_dir) as (database, blobs), progress_bars() as bars:
        copied = make_backup(database, blobs, folder, lambda done, total: bars.report("copy", done, total))
    _report(copied, "could not be copied, since they are missing or damaged; `roomfix check` names them")


def restore(
    folder: Annotated[Path, typer.Argument(exists=True, file_okay=False, help="Folder of a backup.")],
    data_dir: DataDir = None,
    replace: Annotated[
        bool,
        typer.Option("--replace", help="Replace the database too: all goes back to the time of the backup."),
    ] = False,
) -> None:
    """Bring back blobs that are missing or damaged; into a new folder, or with --replace, the database too."""
    settings = settings_from(data_dir=data_dir)
    database = Database(settings.resolved_database_url)
    database_path = sqlite_path(database)
    database.close()
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    blobs = BlobStore.open(
        settings.blob_url, settings.data_dir, settings.cache_dir, settings.blob_cache_bytes
    )
    with progress_bars() as bars:
        copied = restore_backup(
            folder,
            database_path,
            blobs,
            lambda done, total: bars.report("restore", done, total),
            replace=replace,
        )
    _report(copied, "are missing here and not in the backup")


@contextmanager
def _store(data_dir: Path | None) -> Iterator[tuple[Database, BlobStore]]:
    settings = settings_from(data_dir=data_dir)
    database = Database(settings.resolved_database_url)
    try:
        database.migrate()
        yield (
            database,
            BlobStore.open(
                settings.blob_url, settings.data_dir, settings.cache_dir, settings.blob_cache_bytes
            ),
        )
    finally:
        database.close()


def _report(copied: Copied, faulty: str) -> None:
    console.print(f"{copied.copied} blobs copied, {copied.present} were there.")
    if copied.faulty:
        console.print(f"[red]{len(copied.faulty)} blobs {faulty}.[/red]", soft_wrap=True)
        raise typer.Exit(1)
