"""`roomfix upload`: a scan sent to a server, which builds a map of it."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Annotated

import httpx
import typer

from app.commands.build import zip_folder
from app.commands.console import console, json_object, progress_bars
from app.commands.inspect import show_inspection
from app.commands.stream import DEFAULT_SERVER, Server, admin_key
from app.commands.uploads.client import OPTIONS, reason, upload_file
from app.errors import RoomfixError


def upload(
    scan: Annotated[Path, typer.Argument(exists=True, help="The scan: a folder, zip, tar or recording.")],
    venue: Annotated[str, typer.Option(help="The venue that the map is for.")],
    options: Annotated[str, typer.Option(help="JSON, as in POST /database/build.")] = "{}",
    server: Server = DEFAULT_SERVER,
    resume: Annotated[
        str | None, typer.Option(help="Go on with this upload of the same file: what was printed then.")
    ] = None,
    inspect_only: Annotated[
        bool,
        typer.Option(
            "--inspect", help="Say what a build would do; --resume with the same file builds it then."
        ),
    ] = False,
) -> None:
    """Send a scan to a server and queue its build; a broken connection is taken up where it broke."""
    parsed, key = json_object(options), admin_key()
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    with (
        tempfile.TemporaryDirectory() as folder,
        httpx.Client(base_url=server, headers=headers, timeout=OPTIONS.timeout_s) as client,
        progress_bars() as progress,
    ):
        archive = zip_folder(scan, Path(folder) / "scan.zip") if scan.is_dir() else scan
        length = archive.stat().st_size
        sent = upload_file(
            client,
            archive,
            venue,
            resume,
            lambda url: console.print(f"upload {url}"),
            lambda done: progress.report("upload", done, length),
        )
        form = {"options": json.dumps(parsed), "upload": sent.url.rsplit("/", 1)[-1]}
        answer = (
            client.post("/database/inspect", data=form)
            if inspect_only
            else client.post("/database/build", data={"venue": venue, **form})
        )
    if not answer.is_success:
        raise RoomfixError(reason(answer))
    if inspect_only:
        show_inspection(answer.json())
        return
    console.print(
        f"{length:,} bytes sent, the connection broke {sent.breaks} times; build {answer.json()['build']}"
    )
