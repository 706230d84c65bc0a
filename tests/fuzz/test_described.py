"""The server answers what its OpenAPI document says: all checks of schemathesis, with and without a key.

The suite makes some hundred requests to each kind of caller; `make fuzz` makes FUZZ of them per operation and phase.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.fuzz.campaign import Target, attack, target

pytest.importorskip("schemathesis", reason="schemathesis is not installed: pip install 'roomfix[dev]'")
FUZZ = int(os.environ.get("FUZZ", "0"))
EVERY_PHASE = "examples,coverage,fuzzing,stateful"
# Phases of each caller in the suite; the coverage phase alone makes about fifty requests per operation.
SHORT = {"admin": "examples,coverage", "no key": "fuzzing"}
CALLERS = ("no key", "anchor", "locate", "admin") if FUZZ else tuple(SHORT)


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Target]:
    with target(tmp_path_factory.mktemp("fuzz")) as found:
        yield found


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("key", CALLERS)
def test_no_answer_is_outside_of_what_is_described(
    served: Target, key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = attack(served, key, tmp_path, FUZZ or 1, EVERY_PHASE if FUZZ else SHORT[key], None if FUZZ else 1)
    with capsys.disabled():
        print(
            f"\n{key}: {found.cases} requests in {found.seconds:.0f} s, failures: {found.failures or 'none'}"
        )
    assert not found.failures, found.output
    assert found.cases > 40
    assert "Traceback" not in served.log.read_text(encoding="utf-8")
