"""How values are built: by name when they have many fields, and one constant a line."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache

from tests.source_tree import modules_of

MAX_POSITIONAL = 5


@dataclass(frozen=True, slots=True)
class DataClass:
    """A dataclass in the source: the number of its fields, and whether it takes them by keyword only."""

    fields: int
    is_keyword_only: bool


@dataclass(slots=True)
class Source:
    """A module: its syntax tree, the full names of what its names stand for, its classes, and its calls with many
    positional values. The tree is walked once, which takes longer than all checks."""

    name: str
    tree: ast.Module
    names: dict[str, str] = field(default_factory=dict)
    classes: list[ast.ClassDef] = field(default_factory=list)
    long_calls: list[ast.Call] = field(default_factory=list)

    def __post_init__(self) -> None:
        for node in ast.walk(self.tree):
            if isinstance(node, ast.ImportFrom):
                self.names |= {each.asname or each.name: f"{node.module}.{each.name}" for each in node.names}
            elif isinstance(node, ast.Import):
                self.names |= {each.asname: each.name for each in node.names if each.asname}
            elif isinstance(node, ast.ClassDef):
                self.names[node.name] = f"{self.name}.{node.name}"
                self.classes.append(node)
            elif isinstance(node, ast.Call) and len(node.args) > MAX_POSITIONAL:
                self.long_calls.append(node)

    def full_name(self, node: ast.expr) -> str:
        """Return the full name that an expression such as `Pose` or `se3.Pose` stands for, empty for any other."""
        if isinstance(node, ast.Name):
            return self.names.get(node.id, node.id)
        if isinstance(node, ast.Attribute) and (base := self.full_name(node.value)):
            return f"{base}.{node.attr}"
        return ""


@cache
def sources() -> list[Source]:
    """Return all modules of the product and of the bench."""
    modules = {**modules_of("app"), **modules_of("bench")}
    return [
        Source(name, ast.parse(module.path.read_text(encoding="utf-8"))) for name, module in modules.items()
    ]


def decorator_of(source: Source, node: ast.ClassDef) -> ast.expr | None:
    """Return the dataclass decorator of a class, or None."""
    for each in node.decorator_list:
        if source.full_name(each.func if isinstance(each, ast.Call) else each) == "dataclasses.dataclass":
            return each
    return None


def dataclasses_of(all_sources: list[Source]) -> dict[str, DataClass]:
    """Return all dataclasses by their full names; inherited fields are counted."""
    own: dict[str, tuple[int, bool, list[str]]] = {}
    for source in all_sources:
        for node in source.classes:
            if (decorator := decorator_of(source, node)) is None:
                continue
            keywords = decorator.keywords if isinstance(decorator, ast.Call) else []
            count = sum(
                isinstance(each, ast.AnnAssign) and "ClassVar" not in ast.unparse(each.annotation)
                for each in node.body
            )
            by_keyword = any(each.arg == "kw_only" and ast.unparse(each.value) == "True" for each in keywords)
            bases = [source.full_name(each) for each in node.bases]
            own[f"{source.name}.{node.name}"] = count, by_keyword, bases

    def fields_of(name: str) -> int:
        count, _, bases = own.get(name, (0, False, []))
        return count + sum(fields_of(base) for base in bases)

    return {name: DataClass(fields_of(name), by_keyword) for name, (_, by_keyword, _) in own.items()}


def long_calls(source: Source, classes: dict[str, DataClass]) -> Iterator[str]:
    """Yield the calls of dataclasses with more than five positional values."""
    for node in source.long_calls:
        name = source.full_name(node.func)
        if name in classes:
            yield f"{source.name}:{node.lineno}: {name}"


def joined_constants(source: Source) -> Iterator[str]:
    """Yield the assignments of several values to several names at the top of a module, as in `A, B = 1, 2`."""
    for node in source.tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple):
            for each in node.targets:
                if isinstance(each, ast.Tuple):
                    yield f"{source.name}:{node.lineno}: {ast.unparse(each)}"


@cache
def classes() -> dict[str, DataClass]:
    """Return all dataclasses of these modules."""
    return dataclasses_of(sources())


def test_no_call_of_a_dataclass_has_more_than_five_positional_values() -> None:
    wrong = [call for each in sources() for call in long_calls(each, classes())]
    assert not wrong


def test_dataclasses_of_six_or_more_fields_are_keyword_only() -> None:
    wrong = [
        name for name, each in classes().items() if each.fields > MAX_POSITIONAL and not each.is_keyword_only
    ]
    assert not wrong


def test_each_constant_has_a_line_of_its_own() -> None:
    wrong = [line for each in sources() for line in joined_constants(each)]
    assert not wrong


SAMPLE = """
from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from other import Elsewhere, plain

LOW, HIGH = 1, 2
SINGLE = (1, 2)
FOUND, LEFT = plain()


@dataclass(frozen=True)
class Base:
    a: int
    b: int
    c: int
    kind: ClassVar[str] = ""


@dataclasses.dataclass
class Long(Base):
    d: int
    e: int
    f: int


@dataclass(kw_only=True)
class Named(Base):
    d: int
    e: int
    f: int


class Plain:
    pass


Long(1, 2, 3, 4, 5, 6)
Long(1, 2, 3, 4, 5, f=6)
Plain(1, 2, 3, 4, 5, 6)
Elsewhere(1, 2, 3, 4, 5, 6)
plain(1, 2, 3, 4, 5, 6)
"""


def test_the_checks_see_what_they_should() -> None:
    sample = Source("sample", ast.parse(SAMPLE))
    other = Source(
        "other", ast.parse("from dataclasses import dataclass\n@dataclass\nclass Elsewhere:\n    a: int")
    )
    found = dataclasses_of([sample, other])
    assert found == {
        "sample.Base": DataClass(3, False),
        "sample.Long": DataClass(6, False),
        "sample.Named": DataClass(6, True),
        "other.Elsewhere": DataClass(1, False),
    }
    lines = SAMPLE.splitlines()
    calls = [lines.index(f"{name}(1, 2, 3, 4, 5, 6)") + 1 for name in ("Long", "Elsewhere")]
    assert list(long_calls(sample, found)) == [
        f"sample:{calls[0]}: sample.Long",
        f"sample:{calls[1]}: other.Elsewhere",
    ]
    assert list(joined_constants(sample)) == [f"sample:{lines.index('LOW, HIGH = 1, 2') + 1}: (LOW, HIGH)"]
    assert classes()["app.geometry.bundle.Bundle"].is_keyword_only
    assert len(classes()) > 100
