"""`roomfix stream`: a phone that streams its camera to a server."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Annotated, Any

import typer

from app.commands.console import console
from app.commands.stream_client import Answer, read_frames, start_session, stream_frames
from app.settings import Settings

Source = Annotated[Path, typer.Argument(exists=True, help="A folder of images, or a video file.")]
Server = Annotated[str, typer.Option(help="With the key in ROOMFIX_ADMIN_KEY.")]
Venue = Annotated[str, typer.Option(help="The venue that the frames are from.")]
CameraText = Annotated[
    str | None, typer.Option(help="fx,fy,cx,cy[,k1,k2,p1,p2[,k3]], searched for if not given.")
]
Fps = Annotated[float, typer.Option(min=0.1, max=120, help="Frames a second.")]
DEFAULT_SERVER = "http://127.0.0.1:8000"


def stream(
    source: Source,
    venue: Venue,
    server: Server = DEFAULT_SERVER,
    camera: CameraText = None,
    fps: Fps = 10.0,
    destination: Annotated[str | None, typer.Option(help="Where to guide to.")] = None,
    session: Annotated[str | None, typer.Option(help="Go on with this session.")] = None,
) -> None:
    """Stream frames to a server as a phone does, and print each answer; reconnects when the server goes away."""
    frames, key = read_frames(source), admin_key()
    session = session or start_session(server, key, venue=venue, camera=camera, destination=destination)
    console.print(f"session {session}")
    log = asyncio.run(stream_frames(server, session, frames, fps=fps, key=key, on_answer=_print))
    console.print(f"{log.sent} frames sent, {len(log.answers)} answered, {log.reconnects} reconnections")


def _print(answer: Answer) -> None:
    body: dict[str, Any] = answer.body
    if "tracking" not in body:
        console.print(f"frame {answer.sent}: {body.get('detail')}")
        return
    where = body["plan"] or (body["pose"] or {}).get("position")
    place = "" if where is None else f"x {where['x']:.2f}  y {where['y']:.2f}  floor {body['floor']}"
    reason = body["reason"] or ""
    console.print(f"frame {answer.sent}: {body['tracking']} {place}{reason}  {answer.latency_ms:.0f} ms")


def admin_key() -> str | None:
    """Return the key of the settings, None where there is none."""
    key = Settings().admin_key
    return None if key is None else key.get_secret_value()
