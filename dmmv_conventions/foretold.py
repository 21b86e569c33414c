"""What a part refuses of its settings, told before the part is imported.

Parts judge their settings when they are built, by the functions of `dmmv_conventions.checks`. They
need torch, which takes longer to import than a configuration to compose. So the statements of a
constructor that check plain values are read from its source, and run by themselves: the same rules
with the same messages. What they cannot judge from plain values alone waits until the part is
built.
"""

import ast
import inspect
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from types import CodeType, SimpleNamespace
from typing import Any, NamedTuple

from dmmv_conventions import checks
from dmmv_conventions.definitions import Definition, defaults_of, defined, names_of
from dmmv_conventions.targets import nodes

_CHECKS = {name: each for name, each in vars(checks).items() if inspect.isfunction(each)}


def require_foretold(content: Any) -> None:
    """Refuse settings that the constructors of this project refuse, without importing them.

    What is called later (`_partial_`) or with arguments in a row (`_args_`) is not judged, nor is a
    package of somebody else.

    Args:
        content: Plain containers; interpolations have to be resolved.

    Raises:
        ValueError: As the constructor says.
    """
    for _, node in nodes(content):
        if isinstance(node, Mapping) and _is_called(node):
            found = defined(str(node["_target_"]))
            if found is not None and found.is_own:
                _judge(found, {name: _plain(value) for name, value in node.items()})


def _is_called(node: Mapping[str, Any]) -> bool:
    return "_target_" in node and not node.get("_partial_") and "_args_" not in node


class _Unbuilt:
    """Stands for what is still to be built: nobody can compare it, count it or tell its kind."""

    def _unknown(self, *_: object) -> bool:
        raise TypeError("It is not built yet.")

    __eq__ = __bool__ = __float__ = _unknown
    __hash__ = object.__hash__
    __class__ = property(_unknown)  # pyright: ignore[reportAssignmentType]


def _plain(value: Any) -> Any:
    """A setting as its constructor gets it, but for what has to be built first."""
    if isinstance(value, Mapping):
        inner = {name: _plain(each) for name, each in value.items()}
        return _Unbuilt() if "_target_" in inner else inner
    return [_plain(each) for each in value] if isinstance(value, list) else value


_UNKNOWN = (NameError, AttributeError, TypeError, LookupError, ArithmeticError)
"""What a statement ends with that reads what is not there yet; the part itself will judge."""


def _judge(part: Definition, given: Mapping[str, Any]) -> None:
    """Run what checks in the constructor of a part; a value that needs more is left unknown."""
    rules = _rules(part)
    if rules is None:
        return
    arguments = {**rules.defaults, **given}
    known = {**_CHECKS, "math": math, **rules.constants}
    known |= {"self": SimpleNamespace(**arguments)} if rules.of_fields else arguments
    for step in rules.steps:
        try:
            if step.code is not None:
                exec(step.code, known)  # noqa: S102  the project's own source
                continue
        except _UNKNOWN:
            pass
        for name in step.names:
            known.pop(name, None)
    for base, handed in rules.inherited:
        _judge(base, dict(_evaluated(handed, known)))


def _evaluated(expressions: Mapping[str, CodeType], known: dict[str, Any]) -> Iterator[Any]:
    for name, code in expressions.items():
        try:
            yield name, eval(code, known)  # noqa: S307  the project's own source
        except _UNKNOWN:
            continue


class _Step(NamedTuple):
    """A statement of a constructor: run, or, where it does more than check, its names forgotten."""

    code: CodeType | None
    names: frozenset[str]


class _Rules(NamedTuple):
    """What a constructor checks, and what it may read besides its arguments."""

    steps: tuple[_Step, ...]
    constants: Mapping[str, Any]
    defaults: Mapping[str, Any]
    of_fields: bool  # of a data class: the arguments are attributes of `self`
    inherited: tuple[tuple[Definition, Mapping[str, CodeType]], ...]  # what a base class is handed


@cache
def _rules(part: Definition) -> _Rules | None:
    found = part.constructor()
    if found is None:
        return None
    function, owner = found
    of_fields = function.name == "__post_init__"
    defaults = dict(part.defaults() if of_fields else defaults_of(function))
    steps = tuple(_steps(function.body))
    return _Rules(
        steps, dict(owner.constants()), defaults, of_fields, tuple(_inherited(function, owner))
    )


def _steps(body: Sequence[ast.stmt]) -> Iterator[_Step]:
    """The statements up to one that may end the function."""
    for statement in body:
        inner = list(ast.walk(statement))
        if any(isinstance(each, ast.Return | ast.Yield) for each in inner):
            return
        stored = (each for each in inner if isinstance(each, ast.Name))
        names = frozenset(each.id for each in stored if isinstance(each.ctx, ast.Store))
        plain = _is_plain(statement)
        code = compile(ast.Module([statement], []), "constructor", "exec") if plain else None
        if code is not None or names:
            yield _Step(code, names)


def _is_plain(statement: ast.stmt) -> bool:
    """Whether a statement only checks, or gives a name to something."""
    match statement:
        case ast.Expr(ast.Call(ast.Name(name))):
            return name in _CHECKS
        case ast.Assign(targets=[ast.Name() | ast.Tuple()]) | ast.AnnAssign(target=ast.Name()):
            return True
        case ast.For(body=body, orelse=[]) | ast.If(body=body, orelse=[]):
            return all(_is_plain(each) for each in body)
    return False


def _inherited(
    function: ast.FunctionDef, owner: Definition
) -> Iterator[tuple[Definition, Mapping[str, CodeType]]]:
    """What `super().__init__(...)` hands to the constructors of base classes of this project."""
    for statement in function.body:
        match statement:
            case ast.Expr(
                ast.Call(ast.Attribute(ast.Call(ast.Name("super")), "__init__"), given, named)
            ):
                in_a_row = list(itertools.takewhile(_is_one, given))
                by_name = {each.arg: each.value for each in named if each.arg}
                for base in owner.own_bases():
                    constructor = base.constructor()
                    if constructor is not None:
                        placed = zip(names_of(constructor[0]), in_a_row, strict=False)
                        yield (
                            base,
                            {
                                name: compile(ast.Expression(value), name, "eval")
                                for name, value in (dict(placed) | by_name).items()
                            },
                        )


def _is_one(argument: ast.expr) -> bool:
    return not isinstance(argument, ast.Starred)
