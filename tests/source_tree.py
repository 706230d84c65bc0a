"""The project's own source as data: its modules and what each of them imports, late imports included."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True, slots=True)
class Module:
    """A module: its dotted name, its file, and the full names that it imports, wherever in it."""

    name: str
    path: Path
    imports: frozenset[str]

    @property
    def folder(self) -> str:
        """The package that holds the module."""
        return self.name if self.path.name == "__init__.py" else self.name.rpartition(".")[0]


@cache
def modules_of(package: str, root: Path = ROOT) -> dict[str, Module]:
    """Return all modules of a package of the repository, by name."""
    found = {}
    for path in sorted((root / package).rglob("*.py")):
        name = ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
        found[name] = Module(name, path, frozenset(_imports(name, path)))
    return found


def _imports(module: str, path: Path) -> set[str]:
    names = set()
    for node in _statements(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: imports are absolute"
            assert node.module
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def _statements(tree: ast.Module) -> Iterator[ast.stmt]:
    """Yield all statements, without what they are made of, which is most of a tree."""
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.stmt):
            yield node
        for field in ("body", "orelse", "finalbody", "handlers", "cases"):
            waiting += getattr(node, field, [])


def targets(module: Module, modules: dict[str, Module]) -> set[str]:
    """Return the modules among `modules` that a module imports: `a.b.C` is module `a.b`."""
    return {
        name if name in modules else name.rpartition(".")[0]
        for name in module.imports
        if name in modules or name.rpartition(".")[0] in modules
    }


def circles(edges: dict[str, set[str]]) -> list[list[str]]:
    """Return the groups of two or more modules that import each other around (Tarjan's algorithm)."""
    number: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(node: str) -> None:
        number[node] = lowest[node] = len(number)
        stack.append(node)
        for other in edges[node]:
            if other not in number:
                visit(other)
                lowest[node] = min(lowest[node], lowest[other])
            elif other in stack:
                lowest[node] = min(lowest[node], number[other])
        if lowest[node] == number[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                found.append(group)

    for node in edges:
        if node not in number:
            visit(node)
    return found
