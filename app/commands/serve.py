"""`roomfix serve` and `roomfix worker`."""

from __future__ import annotations

import signal
import sys
import threading
from contextlib import suppress
from typing import Annotated, Any

import typer
import uvicorn

from app.api.access.credentials import is_loopback
from app.commands.console import DataDir, settings_from
from app.commands.https import Certificate, make_certificate, own_names, print_phone_access
from app.commands.serving.connections import connection_options
from app.commands.serving.leaving_server import OPTIONS as LEAVING
from app.commands.serving.leaving_server import LeavingServer
from app.commands.serving.memory import freeze_loaded, share_arenas
from app.jobs.worker import run_worker
from app.logs import configure_logs
from app.main import create_app
from app.services.keys.key_service import any_key
from app.settings import Settings
from app.web.phones import PhoneAccess

# Exit code of a server that could not be started.
NOT_STARTED = 3
ALL_ADDRESSES = "0.0.0.0"  # noqa: S104 - what --https serves on, with a key


def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on [ROOMFIX_HOST, 127.0.0.1].")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on [ROOMFIX_PORT, 8000].")] = None,
    data_dir: DataDir = None,
    open_: Annotated[bool, typer.Option("--open", help="Ask for no key; loopback addresses only.")] = False,
    https: Annotated[
        bool,
        typer.Option(
            "--https", help="Serve phones on the local network: https, by a certificate authority of its own."
        ),
    ] = False,
) -> None:
    """Start the server."""
    settings = settings_from(host=host, port=port, data_dir=data_dir, open=open_ or None, https=https or None)
    if settings.https and "host" not in settings.model_fields_set:
        settings = settings.model_copy(update={"host": ALL_ADDRESSES})
    check_access(settings)
    configure_logs(settings.log_level, settings.log_format)
    run_server(settings)


def worker(
    data_dir: DataDir = None,
    kinds: Annotated[
        str | None,
        typer.Option(help="Kinds of builds to take: scan, recording, pictures [ROOMFIX_WORKER_KINDS, all]."),
    ] = None,
) -> None:
    """Run builds for a server that was started with ROOMFIX_RUN_WORKER=false."""
    settings = settings_from(data_dir=data_dir, worker_kinds=kinds)
    configure_logs(settings.log_level, settings.log_format)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    run_worker(settings, threading.Event(), stop)


def check_access(settings: Settings) -> None:
    """Refuse to serve without a key anywhere but on loopback, and with keys where there is none."""
    if settings.open and not is_loopback(settings.host):
        raise typer.BadParameter(
            f"--open serves without a key, so on a loopback address only, not {settings.host}."
        )
    if not settings.open and not any_key(settings):
        raise typer.BadParameter(
            "There is no key yet: make one with roomfix keys create --scope admin --name NAME, or set "
            "ROOMFIX_ADMIN_KEY; or use --open to serve without a key on loopback."
        )


def run_server(settings: Settings) -> None:
    """Serve until interrupted."""
    share_arenas(settings.workers)
    access, certificate = phone_access(settings) if settings.https else (None, None)
    if access is not None:
        print_phone_access(access)
    app = create_app(settings, access=access)
    config = uvicorn.Config(app, **server_options(settings, certificate))
    server = LeavingServer(config, app.state.drain, settings.drain_s, freeze_loaded)
    with suppress(KeyboardInterrupt):
        server.run()
    if not server.started:
        sys.exit(NOT_STARTED)


def phone_access(settings: Settings) -> tuple[PhoneAccess, Certificate]:
    """Return the address that phones open, and the certificate for it."""
    names = own_names(settings.host)
    certificate = make_certificate(settings.data_dir, names)
    return PhoneAccess(f"https://{names[0]}:{settings.port}/", certificate.authority), certificate


def server_options(settings: Settings, certificate: Certificate | None = None) -> dict[str, Any]:
    """Return what uvicorn is started with."""
    tls = {"ssl_certfile": certificate.chain, "ssl_keyfile": certificate.key} if certificate else {}
    return {
        "host": settings.host,
        "port": settings.port,
        "log_config": None,
        "access_log": False,
        "timeout_graceful_shutdown": LEAVING.answers_s,
        "ws_max_size": settings.max_image_bytes,
        **connection_options(),
        **tls,
    }
