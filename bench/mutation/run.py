"""Runs a module's tests against its mutants: each in a process of its own, no file of the tree is changed.

A parent that has imported the libraries is forked for each mutant, which saves most of the time that starting takes.
"""

from __future__ import annotations

import gc
import importlib
import os
import resource
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import CodeType
from typing import Literal, NoReturn

import pytest

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
    "scipy.optimize",
    "scipy.spatial",
    "scipy.stats",
    "shapely",
    "sqlalchemy",
)
# Packages of the repository. The mutation's own modules import no others, so that these can be imported anew.
OWN = ("app", "bench", "tests")
KEPT = "bench.mutation"
# The code by which the copy says that no test imported the module.
NOT_IMPORTED = 120
# Ends with the first failure, about which nothing is to be said; no plugin that takes time to load, but the limit.
PYTEST = ("-x", "-q", "--tb=no", "--assert=plain", "-p", "no:cacheprovider", "-p", "pytest_timeout")
# A mutant that takes so much longer than the module itself doesn't end. Time of the processor, which a busy machine
# doesn't stretch; a mutant that sleeps is ended by pytest's own limit.
PATIENCE = 4.0
LEAST_PATIENCE_S = 20.0


@dataclass(frozen=True, slots=True)
class Tried:
    """A mutant and what the tests made of it."""

    mutant: Mutant
    outcome: Outcome


class _Mutated(MetaPathFinder):
    """Finds one module as a mutant of itself."""

    def __init__(self, name: str, path: Path, mutant: Mutant) -> None:
        self.name, self._path = name, path
        self._code = compile(mutant.tree, str(path), "exec")
        self.was_used = False

    def find_spec(self, fullname: str, *_: object) -> ModuleSpec | None:
        """Return the mutant's spec under the module's own name."""
        if fullname != self.name:
            return None
        self.was_used = True
        loader = _MutantLoader(self.name, str(self._path))
        loader.code = self._code
        return spec_from_file_location(self.name, self._path, loader=loader)


class _MutantLoader(SourceFileLoader):
    code: CodeType

    def get_code(self, _: str) -> CodeType:
        """Return the mutant's code instead of that of the file."""
        return self.code


def import_libraries() -> None:
    """Import what all mutants need."""
    for name in LIBRARIES:
        importlib.import_module(name)


class _Refused(MetaPathFinder):
    """Lets a module, and so what imports it, fail to be imported."""

    def __init__(self, name: str) -> None:
        self._name = name

    def find_spec(self, fullname: str, *_: object) -> None:
        """Raise `ImportError` for the module."""
        if fullname == self._name:
            raise ImportError(f"{fullname} comes later.")


def import_all_but(path: str) -> None:
    """Import the modules of the application that don't import the one at `path`: its mutants needn't do it again.

    Other modules of the repository are forgotten; for a process that runs mutants and nothing else.
    """
    _forget_own()
    refused = _Refused(module_name(path))
    sys.meta_path.insert(0, refused)
    for file in sorted(Path("app").rglob("*.py")):
        with suppress(ImportError):
            importlib.import_module(module_name(str(file)).removesuffix(".__init__"))
    sys.meta_path.remove(refused)
    # What is here stays: the copies need not look through it for garbage.
    gc.freeze()


def _forget_own() -> None:
    for name in [name for name in sys.modules if name.split(".")[0] in OWN and not name.startswith(KEPT)]:
        del sys.modules[name]


def module_name(path: str) -> str:
    """Return the dotted name of a file of the repository."""
    return ".".join(Path(path).with_suffix("").parts)


def baseline_s(tests: Sequence[str]) -> float:
    """Return the processor time of the tests without any change; raises `RuntimeError` when they fail."""
    outcome, seconds = _run(None, tests, None)
    if outcome != "survived":
        raise RuntimeError(f"The tests fail without a mutant: {' '.join(tests)}")
    return seconds


def try_mutant(path: str, mutant: Mutant, tests: Sequence[str], seconds: float) -> Tried:
    """Return what the tests make of a mutant of the module at `path`, which take `seconds` without it."""
    finder = _Mutated(module_name(path), Path(path).resolve(), mutant)
    return Tried(mutant, _run(finder, tests, max(PATIENCE * seconds, LEAST_PATIENCE_S))[0])


def _run(finder: _Mutated | None, tests: Sequence[str], limit_s: float | None) -> tuple[Outcome, float]:
    """Run pytest in a copy of this process; return what came of it, and its processor time."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        _become_pytest(finder, tests, limit_s)
    _, status, usage = os.wait4(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code == NOT_IMPORTED:
        raise RuntimeError(f"No test imports the module: {' '.join(tests)}")
    ended: Outcome = "killed" if code else "survived"
    return "timed out" if code == -signal.SIGXCPU else ended, usage.ru_utime + usage.ru_stime


def _become_pytest(finder: _Mutated | None, tests: Sequence[str], limit_s: float | None) -> NoReturn:
    # Whatever happens here, the copy must not go on with the parent's work.
    code = 1
    try:
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in (1, 2):
            os.dup2(nowhere, stream)
        if limit_s is not None:
            resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s), int(limit_s) + 5))
        if finder is not None:
            if sys.modules.pop(finder.name, None) is not None:
                # Others hold parts of the module as it is.
                _forget_own()
            sys.meta_path.insert(0, finder)
        os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
        code = int(pytest.main([*PYTEST, *tests]))
        if finder is not None and not finder.was_used:
            code = NOT_IMPORTED
    finally:
        os._exit(code)
