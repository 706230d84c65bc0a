"""The command line: the same functions as the endpoints."""

from __future__ import annotations

import ipaddress
import logging
import sys
from pathlib import Path
from typing import Annotated

import typer
import uvicorn
from rich.console import Console

from app.errors import RoomfixError
from app.main import create_app
from app.settings import Settings

app = typer.Typer(
    no_args_is_help=True, add_completion=False, help="Roomfix: tells a camera where it is inside a building."
)
console = Console()
DataDir = Annotated[Path | None, typer.Option(help="Folder for database and blobs [ROOMFIX_DATA_DIR].")]


@app.callback()
def options() -> None:
    """Take no options of its own; being there makes each function a command by its name."""


@app.command()
def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on.")] = None,
    data_dir: DataDir = None,
    open_: Annotated[bool, typer.Option("--open", help="Ask for no key; loopback addresses only.")] = False,
) -> None:
    """Start the server."""
    given = {"host": host, "port": port, "data_dir": data_dir, "open": open_ or None}
    settings = Settings(**{name: value for name, value in given.items() if value is not None})  # type: ignore[arg-type]
    if settings.open and not _is_loopback(settings.host):
        raise typer.BadParameter(f"--open serves without a key, so on a loopback address only, not {settings.host}.")
    if not settings.open and settings.admin_key is None:
        raise typer.BadParameter("Set ROOMFIX_ADMIN_KEY, or use --open to serve without a key on loopback.")
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    uvicorn.run(create_app(settings), host=settings.host, port=settings.port, log_config=None, access_log=False)


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def main() -> None:
    """Run a command; an error that the user can act on is one line, not a traceback."""
    try:
        app()
    except RoomfixError as error:
        console.print(f"[red]Error:[/red] {error}")
        sys.exit(1)


if __name__ == "__main__":
    main()
