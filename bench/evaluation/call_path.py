"""The way of one query through the modules of the product: how often control enters a module that it had left."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import app

ROOT = Path(app.__file__).resolve().parent


@dataclass(frozen=True, slots=True)
class CallPath:
    """The modules whose functions were called, in order; each run of calls within one module is one stay."""

    stays: tuple[str, ...]

    @property
    def modules(self) -> int:
        """How many modules were called."""
        return len(set(self.stays))

    @property
    def returns(self) -> int:
        """How many stays are in a module that had been left before."""
        return len(self.stays) - self.modules


def path_of(modules: Sequence[str]) -> CallPath:
    """Return the path of calls, given the module of each."""
    starts = [name for i, name in enumerate(modules) if i == 0 or modules[i - 1] != name]
    return CallPath(tuple(starts))


def trace(work: Callable[[], Any]) -> CallPath:
    """Run a piece of work on this thread and return its path through `app`."""
    called: list[str] = []
    prefix = f"{ROOT}/"

    def note(frame: FrameType, event: str, _argument: Any) -> None:
        name = frame.f_code.co_filename
        if event == "call" and name.startswith(prefix):
            called.append(name.removeprefix(prefix).removesuffix(".py"))

    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
    return path_of(called)
