"""`roomfix demo`: render the demonstration venue, map its wing, serve it."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from app.commands.build import build_scan, ensure_venue
from app.commands.console import BarProgress, console, progress_bars, settings_from
from app.commands.serve import run_server
from app.commands.serve_phones import run_for_phones
from app.errors import RoomfixError
from app.geometry.plan import plan_position
from app.geometry.se3 import Pose
from app.logs import configure_logs
from app.services.floor_features import store_features
from app.services.floor_plans import PlanFile, store_plan_image
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.settings import Settings
from app.storage.floors import put_floor

if TYPE_CHECKING:
    from bench.demo import DemoFloor, DemoQuery
    from bench.recordings.monitors import MonitorPair

DEFAULT_DIR = Path(".roomfix/demo")
QUERIES = 12
PHONE_VENUE = "demo"
PHONE_PATH = f"go/{PHONE_VENUE}"


def demo(
    host: Annotated[str, typer.Option(help="Loopback address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port to listen on.")] = 8000,
    data_dir: Annotated[
        Path, typer.Option(help="Folder for everything that the demonstration makes.")
    ] = DEFAULT_DIR,
    whole: Annotated[
        bool, typer.Option("--whole", help="Scan both floors (takes minutes), not one wing.")
    ] = False,
    phones: Annotated[
        bool,
        typer.Option("--phones", help="Serve phones too: https on all addresses, with a key in a QR code."),
    ] = False,
    https_port: Annotated[int, typer.Option(help="Port for phones.")] = 8443,
    prepare_only: Annotated[
        bool, typer.Option("--prepare-only", help="Build, print, and don't serve.")
    ] = False,
) -> None:
    """Render the demonstration venue, map it and serve it; starts again in seconds."""
    settings = settings_from(host=host, port=port, data_dir=data_dir, open=True)
    if not prepare_only:
        _check_port(host, port)
    queries, cameras = _prepare(settings, data_dir, whole)
    _print_what_to_try(settings, queries[0])
    _print_camera_to_try(settings, cameras[0])
    if not prepare_only:
        _serve(settings, cameras, https_port if phones else None)


def _serve(settings: Settings, cameras: Sequence[MonitorPair], https_port: int | None) -> None:
    """Serve, phones too where a port for them is given, with fresh frames of the monitoring cameras."""
    from bench.anchors.demo_cameras import FreshFrames

    configure_logs()
    with FreshFrames(_address(settings), cameras):
        if https_port is None:
            run_server(settings)
        else:
            run_for_phones(settings, https_port, PHONE_PATH, PHONE_VENUE)


def _check_port(host: str, port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            raise RoomfixError(
                f"{host}:{port} is in use; choose another with: roomfix demo --port N"
            ) from None


def _prepare(settings: Settings, data_dir: Path, whole: bool) -> tuple[list[DemoQuery], list[MonitorPair]]:
    try:
        from bench.anchors.demo_cameras import put_cameras, render_cameras
        from bench.demo import VENUE, floor_plans, render_queries, render_venue, render_wing
    except ImportError as error:
        raise RoomfixError(
            f"The demonstration needs its extra packages: pip install -e '.[bench]' ({error})."
        ) from None
    region = "venue" if whole else "wing"
    render = render_venue if whole else render_wing
    with progress_bars() as progress:
        console.print("Rendering the demonstration scan (kept for the next start) ...")
        scan = render(
            data_dir / f"scan-{region}", workers=settings.workers, progress=_reporter(progress, "render")
        )
        queries = render_queries(data_dir / "queries", QUERIES)
        cameras = render_cameras(data_dir / "cameras", workers=settings.workers)
        resources = Resources.open(settings)
        try:
            ensure_venue(resources, VENUE.id, VENUE.name)
            for floor in floor_plans():
                _put_floor(resources, VENUE.id, floor)
            for floor in floor_plans():
                # After all floors are there: stairs lead from each to the other.
                store_features(resources, VENUE.id, floor.id, floor.features)
            put_cameras(resources, cameras)
            marker = data_dir / "mapped.json"
            wanted = {"region": region, "poses": len(scan.timestamps_s)}
            if (
                not _is_mapped(resources, VENUE.id)
                or not marker.is_file()
                or json.loads(marker.read_text()) != wanted
            ):
                console.print("Building the map ...")
                options = {"format": "tum", "world_from_scan": Pose.identity().matrix.tolist()}
                build_scan(resources, VENUE.id, scan.directory, options, progress)
                marker.write_text(json.dumps(wanted))
        finally:
            resources.close()
    return list(queries), cameras


def _is_mapped(resources: Resources, venue: str) -> bool:
    try:
        return MapLibrary(resources).active(venue) is not None
    except RoomfixError:
        # Made by another version of the project: build it again.
        return False


def _reporter(progress: BarProgress, stage: str) -> Callable[[int, int], None]:
    return lambda done, total: progress.report(stage, done, total)


def _put_floor(resources: Resources, venue: str, floor: DemoFloor) -> None:
    with resources.database.write() as connection:
        put_floor(
            connection,
            venue,
            floor.id,
            name=floor.name,
            level=floor.level,
            z_min_m=floor.z_min_m,
            z_max_m=floor.z_max_m,
            plan_from_world=floor.plan_from_world,
            plan_residual_m=None,
        )
    u, v = floor.origin_px
    plan = PlanFile(data=floor.plan_png, meters_per_pixel=floor.meters_per_pixel, origin_px=(u, v))
    store_plan_image(resources, venue, floor.id, plan)


def _print_what_to_try(settings: Settings, query: DemoQuery) -> None:
    from bench.demo import floor_plans

    address, camera = _address(settings), _numbers(query.camera.params)
    truth = _truth(query, {floor.level: floor for floor in floor_plans()})
    console.print(f"\nOpen  [bold]{address}/[/bold]  (API: {address}/docs)")
    console.print(f"Studio  {address}/studio\nA simulated phone  {address}/{PHONE_PATH}#simulated\nTry:\n")
    console.print(
        f"curl -s {address}/locate -F venue=demo -F camera={camera} -F image=@{query.path}",
        soft_wrap=True,
        highlight=False,
    )
    console.print("\nThe truth of that photo, to compare the answer with:")
    console.print_json(json.dumps(truth), indent=None)


def _print_camera_to_try(settings: Settings, pair: MonitorPair) -> None:
    from bench.anchors.demo_anchors import anchor_pair

    pictured = anchor_pair(pair)
    console.print("\nA phone in a corner that was not scanned, where a monitoring camera hangs:\n")
    console.print(
        f"curl -s {_address(settings)}/locate -F venue=demo -F method=anchor "
        f"-F camera={_numbers(pictured.phone_camera.params)} "
        f"-F gravity={_numbers(tuple(pictured.gravity_in_phone.round(4) + 0.0))} -F image=@{pair.phone}",
        soft_wrap=True,
        highlight=False,
    )
    x, y = (round(float(value), 3) for value in pictured.phone_on_plan)
    console.print("\nThe truth of it:")
    console.print_json(json.dumps({"floor": str(pair.floor), "plan": {"x": x, "y": y}}), indent=None)


def _address(settings: Settings) -> str:
    return f"http://{settings.host}:{settings.port}"


def _numbers(values: Sequence[float]) -> str:
    return ",".join(f"{value:g}" for value in values)


def _truth(query: DemoQuery, floors: dict[int, DemoFloor]) -> dict[str, Any]:
    pose, floor = query.world_from_camera, floors[query.floor]
    x, y, heading_deg = plan_position(floor.plan_from_world, pose)
    return {
        "floor": floor.id,
        "position": dict(zip("xyz", (round(float(v), 4) for v in pose.translation), strict=True)),
        "quaternion": dict(zip("xyzw", (round(float(v), 5) for v in pose.quaternion), strict=True)),
        "plan": {"x": round(x, 3), "y": round(y, 3), "heading_deg": round(heading_deg, 1)},
    }
