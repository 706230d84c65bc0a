"""The mutants of a module: copies of its syntax tree with one small change each."""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass

# A change of one node of a copied tree, in place.
Change = Callable[[ast.AST], None]

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
# Functions whose messages are for people.
LOGGERS = ("log", "logger")


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """A module with one change: the function it is in ("" outside of all), its line, and the code before and after.

    `node` counts the nodes of the module's tree in the order of `ast.walk` up to the one that `change` changes.
    """

    function: str
    line: int
    before: str
    after: str
    module: ast.Module
    node: int
    change: Change

    @property
    def tree(self) -> ast.Module:
        """The tree of the whole module with the change."""
        changed = copy.deepcopy(self.module)
        # A copy is walked in the order of the original.
        self.change(list(ast.walk(changed))[self.node])
        return ast.fix_missing_locations(changed)

    def __str__(self) -> str:
        return f"{self.line} {self.function or 'module'}: `{self.before}` -> `{self.after}`"


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a node is: the name of its function, and what that returns."""

    function: str
    returns: str


def mutants_of(source: str) -> Iterator[Mutant]:
    """Yield all mutants of a module's source, from the first line to the last."""
    tree = ast.parse(source)
    places = _places(tree)
    found = []
    for index, node in enumerate(ast.walk(tree)):
        place = places.get(node)
        if place is None:
            continue
        for change in _changes(node, place):
            changed = copy.deepcopy(node)
            change(changed)
            mutant = Mutant(
                function=place.function,
                line=getattr(node, "lineno", 0),
                before=_short(ast.unparse(node)),
                after=_short(ast.unparse(changed)),
                module=tree,
                node=index,
                change=change,
            )
            found.append(mutant)
    yield from sorted(found, key=lambda mutant: mutant.line)


def _short(code: str, length: int = 90) -> str:
    line = " ".join(code.split())
    return line if len(line) <= length else line[: length - 3] + "..."


def _places(tree: ast.Module) -> dict[ast.AST, _Place]:
    """Return the place of every node that may be changed: no annotation, decorator, assertion, log line or message of
    an error."""
    places: dict[ast.AST, _Place] = {}

    def visit(node: ast.AST, place: _Place) -> None:
        if isinstance(node, ast.Assert | ast.Raise) or _is_log(node):
            return
        if isinstance(node, ast.FunctionDef):
            name = f"{place.function}.{node.name}" if place.function else node.name
            place = _Place(name, "" if node.returns is None else ast.unparse(node.returns))
        elif isinstance(node, ast.ClassDef):
            place = _Place(f"{place.function}.{node.name}" if place.function else node.name, "")
        places[node] = place
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "returns", "decorator_list", "bases", "format_spec"):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    visit(child, place)

    visit(tree, _Place("", ""))
    return places


def _is_log(node: ast.AST) -> bool:
    if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)):
        return False
    called = node.value.func
    return (
        isinstance(called, ast.Attribute)
        and isinstance(called.value, ast.Name)
        and called.value.id in LOGGERS
    )


def _changes(node: ast.AST, place: _Place) -> Iterator[Change]:
    """Yield what may be changed of one node."""
    if isinstance(node, ast.Compare):
        for i, operator in enumerate(node.ops):
            yield from (_operator_of_comparison(i, other) for other in COMPARISONS[type(operator)])
    elif isinstance(node, ast.BoolOp):
        yield _field("op", ast.Or() if isinstance(node.op, ast.And) else ast.And())
        yield from (_without_value(i) for i in range(len(node.values)))
    elif isinstance(node, ast.BinOp | ast.AugAssign):
        if type(node.op) in OPERATORS:
            yield _field("op", OPERATORS[type(node.op)]())
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitAnd | ast.BitOr):
            yield _same_operands("left", "right")
            yield _same_operands("right", "left")
    elif isinstance(node, ast.UnaryOp):
        yield from _without_unary(node)
    elif isinstance(node, ast.If | ast.IfExp):
        yield _field("test", ast.Constant(True))
        yield _field("test", ast.Constant(False))
    elif isinstance(node, ast.Constant):
        yield from (_field("value", value) for value in _other_values(node.value, bool(place.returns)))
    elif isinstance(node, ast.Return) and node.value is not None:
        yield from _returned_constants(node.value, place.returns)
    elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Attribute | ast.Subscript):
        # What is to be kept is not.
        yield _field("targets", [ast.Name("_", ast.Store())])
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield _field("value", ast.Constant(None))


def _field(name: str, value: object) -> Change:
    return lambda node: setattr(node, name, value)


def _operator_of_comparison(index: int, other: type[ast.cmpop]) -> Change:
    def change(node: ast.AST) -> None:
        assert isinstance(node, ast.Compare)  # noqa: S101 - the node that this was made for
        node.ops[index] = other()

    return change


def _without_value(index: int) -> Change:
    def change(node: ast.AST) -> None:
        assert isinstance(node, ast.BoolOp)  # noqa: S101 - the node that this was made for
        # A neighbour in its place, since one value alone makes no such node.
        node.values[index] = copy.deepcopy(node.values[index - 1])

    return change


def _same_operands(kept: str, lost: str) -> Change:
    return lambda node: setattr(node, lost, copy.deepcopy(getattr(node, kept)))


def _without_unary(node: ast.UnaryOp) -> Iterator[Change]:
    if isinstance(node.op, ast.Not):
        # Twice, since a node can't be replaced by its operand in place.
        yield lambda it: setattr(it, "operand", ast.UnaryOp(ast.Not(), getattr(it, "operand")))  # noqa: B009
    elif isinstance(node.op, ast.USub):
        yield _field("op", ast.UAdd())
    elif isinstance(node.op, ast.Invert):
        yield lambda it: setattr(it, "operand", ast.UnaryOp(ast.Invert(), getattr(it, "operand")))  # noqa: B009


def _other_values(value: object, in_function: bool) -> list[object]:
    """Return other values for a constant: neighbours in a function, and twice and half of a limit, which is a number
    outside of all functions: no test has to tell one well-chosen limit from another that is nearly the same."""
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, int):
        if in_function:
            return [value + 1, value - 1]
        return [2 * value, value // 2] if value else [1]
    if isinstance(value, float):
        return [2.0 * value, 0.5 * value] if value else [1.0]
    return []


def _returned_constants(value: ast.expr, returns: str) -> Iterator[Change]:
    constants: list[bool | int | None] = []
    if returns == "bool":
        constants = [True, False]
    elif returns in ("int", "float"):
        constants = [0]
    if "None" in returns:
        constants.append(None)
    written = ast.unparse(value)
    yield from (_field("value", ast.Constant(each)) for each in constants if repr(each) != written)
