"""A PostgreSQL server of our own, where the machine has one installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

BINARIES = sorted(Path("/usr/lib/postgresql").glob("*/bin")) if Path("/usr/lib/postgresql").is_dir() else []
USER = "postgres"


def is_installed() -> bool:
    """Whether a server can be started here."""
    try:
        import psycopg  # noqa: F401
    except ImportError:
        return False
    return bool(BINARIES)


@contextmanager
def postgres() -> Iterator[str]:
    """Start a server on a socket of its own; give the URL of an empty database."""
    folder = Path(tempfile.mkdtemp(prefix="pg-"))
    binaries = BINARIES[-1]
    # The server refuses to run as root.
    as_user = ["setpriv", f"--reuid={USER}", f"--regid={USER}", "--clear-groups"] if os.geteuid() == 0 else []
    if as_user:
        shutil.chown(folder, USER)
    data = str(folder / "data")

    def run(program: str, *arguments: str) -> None:
        subprocess.run(  # noqa: S603 - the server's own programs
            [*as_user, str(binaries / program), *arguments], check=True, stdout=subprocess.DEVNULL, cwd=folder
        )

    run("initdb", "-D", data, "-U", USER, "--auth=trust", "--no-sync")
    run(
        "pg_ctl",
        "-D",
        data,
        "-w",
        "-l",
        str(folder / "log"),
        "-o",
        f"-c listen_addresses='' -c fsync=off -k {folder}",
        "start",
    )
    try:
        yield f"postgresql+psycopg://{USER}@/postgres?host={folder}"
    finally:
        run("pg_ctl", "-D", data, "-m", "immediate", "stop")
        shutil.rmtree(folder, ignore_errors=True)
