"""A server in a process of its own, to be killed: `live_server.py DATA_DIR PORT`, its worker the slow one."""

from __future__ import annotations

import sys
from pathlib import Path

import uvicorn

from app.jobs.embedded import EmbeddedRunner
from app.main import create_app
from app.settings import Settings

SLOW_WORKER = (sys.executable, str(Path(__file__).with_name("slow_worker.py")))


def main() -> None:
    """Serve until killed; says the worker's process id in the file `worker.pid`."""
    data_dir, port = Path(sys.argv[1]), int(sys.argv[2])
    settings = Settings(_env_file=None, data_dir=data_dir, open=True)
    runner = EmbeddedRunner(settings, SLOW_WORKER)
    uvicorn.run(create_app(settings, runner), host="127.0.0.1", port=port, log_level="warning")


if __name__ == "__main__":
    main()
