"""Mutants of a small module, and what its tests make of them."""

from __future__ import annotations

import ast
import importlib
import sys
from pathlib import Path

import pytest

from bench.mutation.__main__ import chosen_mutants, drawn_mutants
from bench.mutation.mutants import Mutant, mutants_of
from bench.mutation.report import OPEN, write_section
from bench.mutation.run import Tried, baseline_s, try_mutant
from bench.mutation.survivors import key_of, read_reasons, summary_of
from bench.mutation.targets import TARGETS, Target

SOURCE = '''"""A toy."""
LIMIT = 4.0
COUNT: int = 3

def is_far(metres: float, steps: int = 0) -> bool:
    """Whether something is far."""
    assert steps >= 0
    if not metres:
        raise ValueError(f"{steps + 1} steps")
    return metres > LIMIT and steps >= 10

class Toy:
    def middle(self, a: float) -> float | None:
        return -a / 2 if a else None
'''
TESTS = """
import pytest
from toy import Toy, is_far

def test_far():
    assert is_far(5.0, 10) and not is_far(3.0, 10) and not is_far(5.0, 9)
    assert Toy().middle(4.0) == -2.0 and Toy().middle(0.0) is None
    with pytest.raises(ValueError):
        is_far(0.0)
"""


def changes(source: str) -> list[str]:
    return [str(mutant) for mutant in mutants_of(source)]


def test_every_kind_of_change_is_made_once() -> None:
    found = changes(SOURCE)
    for change in (
        "2 module: `4.0` -> `8.0`",
        "2 module: `4.0` -> `2.0`",
        "3 module: `3` -> `6`",
        "3 module: `3` -> `1`",
        "5 is_far: `0` -> `1`",
        "8 is_far: `not metres` -> `not not metres`",
        "10 is_far: `metres > LIMIT` -> `metres >= LIMIT`",
        "10 is_far: `metres > LIMIT` -> `metres <= LIMIT`",
        "10 is_far: `metres > LIMIT and steps >= 10` -> `metres > LIMIT or steps >= 10`",
        "10 is_far: `metres > LIMIT and steps >= 10` -> `steps >= 10 and steps >= 10`",
        "10 is_far: `metres > LIMIT and steps >= 10` -> `metres > LIMIT and metres > LIMIT`",
        "10 is_far: `10` -> `11`",
        "10 is_far: `10` -> `9`",
        "10 is_far: `return metres > LIMIT and steps >= 10` -> `return True`",
        "10 is_far: `return metres > LIMIT and steps >= 10` -> `return False`",
        "14 Toy.middle: `-a` -> `+a`",
        "14 Toy.middle: `-a / 2` -> `-a * 2`",
        "14 Toy.middle: `-a / 2 if a else None` -> `-a / 2 if True else None`",
        "14 Toy.middle: `return -a / 2 if a else None` -> `return None`",
    ):
        assert found.count(change) == 1, change
    # Assertions, messages and annotations stay.
    assert not any(line.startswith(("7 ", "9 ")) for line in found)
    assert not any("float" in line.split(": ")[1] for line in found if line.startswith(("5 ", "13 ")))


def test_parts_of_a_mask_calls_and_assignments_are_left_out() -> None:
    found = changes(
        "def f(a, b):\n    log.info('x')\n    a.clear()\n    b &= ~a\n    a.x = b\n    return a & b\n"
    )
    assert found == [
        "3 f: `a.clear()` -> `None`",
        "4 f: `b &= ~a` -> `b |= ~a`",
        "4 f: `~a` -> `~~a`",
        "5 f: `a.x = b` -> `_ = b`",
        "6 f: `a & b` -> `a | b`",
        "6 f: `a & b` -> `a & a`",
        "6 f: `a & b` -> `b & b`",
    ]


def test_a_share_is_drawn_in_order_and_the_same_with_the_same_seed() -> None:
    mutants = list(mutants_of(SOURCE))
    assert drawn_mutants(mutants, 1.0, 3) == mutants
    half = drawn_mutants(mutants, 0.5, 3)
    assert len(half) == round(len(mutants) / 2)
    assert half == drawn_mutants(mutants, 0.5, 3) != drawn_mutants(mutants, 0.5, 4)
    assert [mutant for mutant in mutants if mutant in half] == half
    for share in (0.0, 1.1):
        with pytest.raises(ValueError, match="--share"):
            drawn_mutants(mutants, share, 0)


def test_all_mutants_are_modules() -> None:
    mutants = list(mutants_of(SOURCE))
    for mutant in mutants:
        compile(mutant.tree, "toy.py", "exec")
    assert len({ast.unparse(mutant.tree) for mutant in mutants}) == len(mutants)


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the module and its tests."""
    (tmp_path / "toy.py").write_text(SOURCE)
    (tmp_path / "test_toy.py").write_text(TESTS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def mutant_of(change: str) -> Mutant:
    return next(mutant for mutant in mutants_of(SOURCE) if str(mutant) == change)


def test_tests_kill_what_they_notice_and_no_file_changes(toy: Path) -> None:
    tests = [str(toy / "test_toy.py")]
    seconds = baseline_s(tests)
    for change, outcome in (
        ("10 is_far: `10` -> `11`", "killed"),
        ("14 Toy.middle: `-a` -> `+a`", "killed"),
        ("2 module: `4.0` -> `8.0`", "killed"),
        ("10 is_far: `metres > LIMIT` -> `metres >= LIMIT`", "survived"),
    ):
        assert try_mutant("toy.py", mutant_of(change), tests, seconds).outcome == outcome, change
    assert (toy / "toy.py").read_text() == SOURCE


def test_a_module_that_was_imported_before_is_mutated_all_the_same(
    toy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(toy)
    monkeypatch.delitem(sys.modules, "toy", raising=False)
    importlib.import_module("toy")
    tests = [str(toy / "test_toy.py")]
    assert try_mutant("toy.py", mutant_of("10 is_far: `10` -> `11`"), tests, 1.0).outcome == "killed"
    sys.modules.pop("toy")


def test_tests_that_do_not_import_the_module_prove_nothing(toy: Path) -> None:
    (toy / "test_other.py").write_text("def test_passes(): assert True\n")
    with pytest.raises(RuntimeError, match="No test imports"):
        try_mutant("toy.py", mutant_of("10 is_far: `10` -> `11`"), [str(toy / "test_other.py")], 1.0)


def test_without_passing_tests_there_is_nothing_to_see(toy: Path) -> None:
    (toy / "test_toy.py").write_text("def test_fails(): assert False\n")
    with pytest.raises(RuntimeError, match="fail without a mutant"):
        baseline_s([str(toy / "test_toy.py")])


def test_the_page_tells_equivalent_mutants_from_open_ones(tmp_path: Path) -> None:
    killed = mutant_of("10 is_far: `10` -> `11`")
    left = mutant_of("10 is_far: `metres > LIMIT` -> `metres >= LIMIT`")
    other = mutant_of("5 is_far: `0` -> `1`")
    tried = [
        Tried(killed, "killed"),
        Tried(killed, "timed out"),
        Tried(left, "survived"),
        Tried(other, "survived"),
    ]
    file = tmp_path / "equivalent.toml"
    entry = 'function = "is_far"\nbefore = "0"\nafter = "1"\nreason = "Why."\n'
    file.write_text(f'[[mutant]]\nmodule = "app/toy.py"\n{entry}')
    reasons = read_reasons("app/toy.py", file)
    assert reasons == {("is_far", "0", "1"): "Why."}
    assert read_reasons("app/other.py", file) == {}
    assert summary_of(tried, reasons) == "4 mutants: 2 killed, 1 behave as the module does, 1 open."
    page = write_section("app/toy.py", tried, reasons, tmp_path).read_text()
    assert "## app/toy.py\n" in page
    assert f"`metres > LIMIT` becomes `metres >= LIMIT` | {OPEN} |" in page
    assert "| `is_far` | `0` becomes `1` | Why. |" in page


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.path)
def test_what_is_mutated_and_what_is_explained_is_there(target: Target) -> None:
    there = {key_of(mutant) for mutant in chosen_mutants(target)}
    assert there
    assert set(read_reasons(target.path)) <= there
    files = [name for name in target.tests if not name.startswith("-")]
    assert all(Path(name).is_file() for name in files)


def test_a_function_that_is_gone_is_no_silent_success() -> None:
    with pytest.raises(ValueError, match="no mutants in gone"):
        chosen_mutants(Target(TARGETS[0].path, (), ("gone",)))
