"""`roomfix keys`: the keys of a server, made where its database is; the server need not run."""

from __future__ import annotations

import re
from typing import Annotated

import typer
from rich.table import Table

from app.commands.console import DataDir, console, errors, settings_from
from app.errors import InvalidInputError
from app.services.keys.caller import Caller
from app.services.keys.key_service import KeyService, key_service
from app.storage.audit import Act
from app.storage.db import now
from app.storage.keys import Key, Scope

app = typer.Typer(no_args_is_help=True, help="Make, list and revoke keys.")
SECONDS = {"m": 60, "h": 3600, "d": 86_400}
OPERATOR = Caller(name="command line", scope="admin")


@app.command()
def create(
    name: Annotated[str, typer.Option(help="Whose key it is.")],
    scope: Annotated[Scope, typer.Option(help="What it may do; admin may do everything.")],
    venue: Annotated[str | None, typer.Option(help="Limit it to this venue.")] = None,
    camera: Annotated[
        str | None, typer.Option(help="Scope anchor: limit it to this monitoring camera.")
    ] = None,
    expires: Annotated[str | None, typer.Option(help="After how long it ends: 30d, 12h, 45m.")] = None,
    data_dir: DataDir = None,
) -> None:
    """Make a key and print it; it can't be shown again."""
    seconds = None if expires is None else duration_s(expires)
    with key_service(settings_from(data_dir=data_dir)) as keys:
        made = keys.create(OPERATOR, name, scope, venue, camera_id=camera, expires_in_s=seconds)
        _note(keys, "create", made.key)
    errors.print(f"Key {made.key.id}: keep it now, it is not shown again.")
    # To standard output the key alone, so that a script can take it.
    typer.echo(made.text)


@app.command(name="list")
def list_all(data_dir: DataDir = None) -> None:
    """List keys: what they may do, until when, and when they were last used."""
    with key_service(settings_from(data_dir=data_dir)) as keys:
        table = Table("key", "name", "scope", "venue", "camera", "state", "last used")
        for key in keys.list(OPERATOR):
            table.add_row(
                key.id,
                key.name,
                key.scope,
                key.venue_id or "all",
                key.camera_id or "",
                state_of(key),
                f"{key.last_used_at:%Y-%m-%d %H:%M}" if key.last_used_at else "never",
            )
    console.print(table)


@app.command()
def revoke(key: Annotated[str, typer.Argument(help="The key's id.")], data_dir: DataDir = None) -> None:
    """Revoke a key with all its tokens, from the next call on."""
    with key_service(settings_from(data_dir=data_dir)) as keys:
        revoked = keys.revoke(OPERATOR, key)
        _note(keys, "revoke", revoked)
    console.print(f"Key {key} is revoked.")


def duration_s(text: str) -> float:
    """Return the seconds of a duration such as 30d, 12h or 45m; raises `InvalidInputError`."""
    match = re.fullmatch(r"(\d{1,6})([mhd])", text.strip())
    if match is None:
        raise InvalidInputError("--expires must be a number with m, h or d after it, such as 30d.")
    return float(int(match[1]) * SECONDS[match[2]])


def state_of(key: Key) -> str:
    """Return whether a key is valid, and until when."""
    if key.revoked_at is not None:
        return "revoked"
    if key.is_expired(now()):
        return "expired"
    return "valid" if key.expires_at is None else f"until {key.expires_at:%Y-%m-%d %H:%M}"


def _note(keys: KeyService, verb: str, key: Key) -> None:
    act = Act(
        key_id=None,
        key_name=OPERATOR.name,
        act=f"roomfix keys {verb}",
        target=key.id,
        venue_id=key.venue_id,
        address=None,
    )
    keys.note_act(act)
