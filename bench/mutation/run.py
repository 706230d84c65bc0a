"""Runs a module's tests against its mutants: each in a process of its own, no file of the tree is changed.

A parent that has imported the libraries is forked for each mutant, which saves most of the time that starting takes.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import CodeType
from typing import Literal

from bench.mutation.mutants import Mutant

Outcome = Literal["killed", "timed out", "survived"]

# What the tests import of others, and no module that is mutated or imports one.
LIBRARIES = (
    "alembic.command",
    "cv2",
    "faiss",
    "fastapi.testclient",
    "httpx",
    "networkx",
    "numpy",
    "obstore",
    "onnxruntime",
    "poselib",
    "pydantic_settings",
    "pytest",
    "scipy.optimize",
    "scipy.spatial",
    "scipy.stats",
    "shapely",
    "sqlalchemy",
)
# A mutant that takes so much longer than the module itself doesn't end.
PATIENCE, LEAST_PATIENCE_S = 4.0, 20.0
POLL_S = 0.02


@dataclass(frozen=True, slots=True)
class Tried:
    """A mutant and what the tests made of it."""

    mutant: Mutant
    outcome: Outcome


class _Mutated(MetaPathFinder):
    """Finds one module as a mutant of itself."""

    def __init__(self, name: str, path: Path, mutant: Mutant) -> None:
        self._name, self._path, self._mutant = name, path, mutant

    def find_spec(self, fullname: str, *_: object) -> ModuleSpec | None:
        """Return the mutant's spec under the module's own name."""
        if fullname != self._name:
            return None
        loader = _MutantLoader(self._name, str(self._path))
        loader.code = compile(self._mutant.tree, str(self._path), "exec")
        return spec_from_file_location(self._name, self._path, loader=loader)


class _MutantLoader(SourceFileLoader):
    code: CodeType

    def get_code(self, _: str) -> CodeType:
        """Return the mutant's code instead of that of the file."""
        return self.code


def import_libraries() -> None:
    """Import what all mutants need."""
    for name in LIBRARIES:
        importlib.import_module(name)


def module_name(path: str) -> str:
    """Return the dotted name of a file of the repository."""
    return ".".join(Path(path).with_suffix("").parts)


def baseline_s(tests: Sequence[str]) -> float:
    """Return how long the tests take without any change; raises `RuntimeError` when they fail."""
    began = time.monotonic()
    if _outcome(_fork(None, tests), None) != "survived":
        raise RuntimeError(f"The tests fail without a mutant: {' '.join(tests)}")
    return time.monotonic() - began


def try_mutant(path: str, mutant: Mutant, tests: Sequence[str], seconds: float) -> Tried:
    """Return what the tests make of a mutant of the module at `path`, in `seconds` times `PATIENCE` at most."""
    limit_s = max(PATIENCE * seconds, LEAST_PATIENCE_S)
    finder = _Mutated(module_name(path), Path(path).resolve(), mutant)
    return Tried(mutant, _outcome(_fork(finder, tests), limit_s))


def _fork(finder: MetaPathFinder | None, tests: Sequence[str]) -> int:
    """Start pytest in a copy of this process, and return its number."""
    sys.stdout.flush()
    child = os.fork()
    if child:
        return child
    # Whatever happens here, the copy must not go on with the parent's work.
    code = 1
    try:
        os.setpgid(0, 0)
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in (1, 2):
            os.dup2(nowhere, stream)
        if finder is not None:
            sys.meta_path.insert(0, finder)
        import pytest

        code = int(pytest.main(["-x", "-q", "--tb=no", "-p", "no:cacheprovider", *tests]))
    finally:
        os._exit(code)


def _outcome(child: int, limit_s: float | None) -> Outcome:
    began = time.monotonic()
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return "survived" if os.waitstatus_to_exitcode(status) == 0 else "killed"
        if limit_s is not None and time.monotonic() - began > limit_s:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return "timed out"
        time.sleep(POLL_S)
