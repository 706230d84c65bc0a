"""The command line: the same functions as the endpoints. A command's module is imported when the command is called."""

from __future__ import annotations

import gc
import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import typer
from typer.core import TyperGroup
from typer.main import get_command_from_info
from typer.models import CommandInfo

from app.errors import RoomfixError

# Command -> the function that runs it, as `module:function`.
COMMANDS = {
    "serve": "app.commands.serve:serve",
    "worker": "app.commands.serve:worker",
    "inspect": "app.commands.inspect:inspect",
    "marker": "app.commands.marker:marker",
    "build": "app.commands.build:build",
    "upload": "app.commands.upload:upload",
    "locate": "app.commands.build:locate",
    "sweep": "app.commands.build:sweep",
    "check": "app.commands.maintain:check",
    "backup": "app.commands.maintain:backup",
    "restore": "app.commands.maintain:restore",
    "export-venue": "app.commands.venue_file:export_venue",
    "import-venue": "app.commands.venue_file:import_venue",
    "calibrate": "app.commands.calibrate:calibrate",
    "keys": "app.commands.keys:app",
    "import-plan": "app.commands.import_plan:import_plan",
    "export-plan": "app.commands.export_plan:export_plan",
    "push-frames": "app.commands.push_frames:push_frames",
    "stream": "app.commands.stream:stream",
}
CHECKOUT = Path(__file__).resolve().parent.parent


def bench_commands(checkout: Path = CHECKOUT) -> dict[str, str]:
    """Return the commands of the bench, which only a checkout of the repository has."""
    if not (checkout / "bench" / "commands" / "__init__.py").is_file():
        return {}
    if str(checkout) not in sys.path:
        sys.path.append(str(checkout))
    commands: dict[str, str] = importlib.import_module("bench.commands").COMMANDS
    return commands


def _imported(module: str) -> ModuleType:
    """Import a module, and search for garbage only afterwards: what modules define stays, and the searches take an
    eighth of the time in which `roomfix serve` is imported."""
    is_enabled = gc.isenabled()
    gc.disable()
    try:
        return importlib.import_module(module)
    finally:
        if is_enabled:
            gc.enable()


class LazyCommands(TyperGroup):
    """A group whose commands are known by name, and imported one by one."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002 - click's signature
        """Return the names of all commands."""
        return [*COMMANDS, *bench_commands()]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002 - as above
        """Return a command, or None for a name that is none."""
        target = COMMANDS.get(cmd_name) or bench_commands().get(cmd_name)
        if target is None:
            return None
        module, function = target.split(":")
        callback = getattr(_imported(module), function)
        if isinstance(callback, typer.Typer):
            return typer.main.get_group(callback)
        info = CommandInfo(name=cmd_name, callback=callback)
        return get_command_from_info(info, pretty_exceptions_short=True, rich_markup_mode="rich")


app = typer.Typer(
    cls=LazyCommands,
    no_args_is_help=True,
    add_completion=False,
    help="Roomfix: tells a camera where it is inside a building.",
)


@app.callback()
def _group() -> None:
    """Roomfix: tells a camera where it is inside a building."""


def main(*args: Any, **options: Any) -> None:
    """Run a command; an error that the user can act on is one line, not a traceback."""
    try:
        app(*args, **options)
    except RoomfixError as error:
        from app.commands.console import errors

        errors.print(f"[red]Error:[/red] {error}")
        sys.exit(1)


if __name__ == "__main__":
    main()
