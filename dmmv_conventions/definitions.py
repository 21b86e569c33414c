"""Where a dotted name is defined, found in the sources without importing them."""

import ast
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from dmmv_conventions.targets import PROJECT

Constructor = tuple[ast.FunctionDef, "Definition"]

LIBRARIES = ("lightning_fabric", "pytorch_lightning", "torch")
"""Packages besides this project's whose sources are read, for arguments and their types alone."""


class Annotation(NamedTuple):
    """The type of an argument, and the source whose names it uses."""

    node: ast.expr
    source: ast.Module

    def of(self, node: ast.expr) -> "Annotation":
        """A part of it."""
        return self._replace(node=node)


class Field(NamedTuple):
    """A field of a data class or a named tuple."""

    name: str
    annotation: Annotation
    default: ast.expr | None


class Definition(NamedTuple):
    """A class or a function, and the source in which it stands."""

    node: ast.ClassDef | ast.FunctionDef
    module: str
    source: ast.Module

    @property
    def is_own(self) -> bool:
        """Whether this project defines it."""
        return self.module.partition(".")[0] in PROJECT

    def bases(self) -> Iterator["Definition | None"]:
        """Base classes, None for those that are not found; none of a function."""
        for base in self.node.bases if isinstance(self.node, ast.ClassDef) else ():
            name = ast.unparse(base.value if isinstance(base, ast.Subscript) else base)
            yield defined(f"{self.module}.{name}") or defined(self._imported(name))

    def _imported(self, name: str) -> str:
        """A dotted name with what its beginning, a module, stands for by an import."""
        first, _, rest = name.partition(".")
        for each in self.source.body:
            for alias in each.names if isinstance(each, ast.Import | ast.ImportFrom) else ():
                if first == (alias.asname or alias.name):
                    package = f"{each.module}." if isinstance(each, ast.ImportFrom) else ""
                    return f"{package}{alias.name}.{rest}"
        return name

    def own_bases(self) -> Iterator["Definition"]:
        """Base classes that this project defines."""
        yield from (base for base in self.bases() if base is not None and base.is_own)

    def _methods(self) -> dict[str, ast.FunctionDef]:
        return {each.name: each for each in self.node.body if isinstance(each, ast.FunctionDef)}

    def constructor(self) -> Constructor | None:
        """The function that judges the arguments, `__init__`, `__post_init__` or itself.

        It comes with the class in which it stands, which may be a base.
        """
        if isinstance(self.node, ast.FunctionDef):
            return self.node, self
        methods = self._methods()
        for name in ("__init__", "__post_init__"):
            if name in methods:
                return methods[name], self
        return next(filter(None, (base.constructor() for base in self.own_bases())), None)

    def arguments(self) -> frozenset[str] | None:
        """Names of the arguments it takes; None where that is not to be seen, or any are taken."""
        if isinstance(self.node, ast.FunctionDef):
            return _taken(self.node)
        methods = self._methods()
        if "__new__" in methods:
            return None
        if "__init__" in methods:
            return _taken(methods["__init__"])
        marks = {ast.unparse(each).partition("(")[0] for each in self.node.decorator_list}
        marks |= {ast.unparse(each) for each in self.node.bases}
        if marks & {"dataclass", "NamedTuple"}:
            return frozenset(field.name for field in self.fields())
        first = next(self.bases(), None)
        return None if first is None else first.arguments()

    def annotations(self) -> Iterator[tuple[str, Annotation]]:
        """Arguments of the constructor with their types, as far as they are written."""
        found = self.constructor()
        if found is not None and found[0].name != "__post_init__":
            taken = found[0].args
            for each in (*taken.posonlyargs, *taken.args, *taken.kwonlyargs):
                if each.annotation is not None:
                    yield each.arg, Annotation(each.annotation, found[1].source)
            return
        yield from ((field.name, field.annotation) for field in self.fields())
        if found is None and (first := next(self.bases(), None)) is not None:
            yield from first.annotations()

    def fields(self) -> Iterator[Field]:
        """Fields of a data class or a named tuple, inherited ones first."""
        for base in self.own_bases():
            yield from base.fields()
        for each in self.node.body:
            if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name):
                annotation = Annotation(each.annotation, self.source)
                yield Field(each.target.id, annotation, each.value)

    def defaults(self) -> Iterator[tuple[str, Any]]:
        """Fields whose default is a plain value."""
        for field in self.fields():
            if field.default is not None:
                yield from _literal(field.name, field.default)

    def constants(self) -> Iterator[tuple[str, Any]]:
        """Plain values that stand at the top of the module."""
        for each in self.source.body:
            if isinstance(each, ast.Assign) and isinstance(each.targets[0], ast.Name):
                yield from _literal(each.targets[0].id, each.value)


def _taken(function: ast.FunctionDef) -> frozenset[str] | None:
    """Names of the arguments of a function, None where it takes any."""
    if function.args.kwarg is not None:
        return None
    return frozenset([*names_of(function), *(each.arg for each in function.args.kwonlyargs)])


def names_of(function: ast.FunctionDef) -> list[str]:
    """Arguments that may be given in a row, without `self`."""
    names = [each.arg for each in function.args.posonlyargs + function.args.args]
    return names[1:] if names[:1] == ["self"] else names


def defaults_of(function: ast.FunctionDef) -> Iterator[tuple[str, Any]]:
    """Arguments whose default is a plain value."""
    arguments = function.args
    placed = arguments.posonlyargs + arguments.args
    pairs = [
        *zip(placed[len(placed) - len(arguments.defaults) :], arguments.defaults, strict=True),
        *zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True),
    ]
    for argument, value in pairs:
        if value is not None:
            yield from _literal(argument.arg, value)


def _literal(name: str, value: ast.expr) -> Iterator[tuple[str, Any]]:
    try:
        yield name, ast.literal_eval(value)
    except ValueError:
        return


@cache
def defined(name: str) -> Definition | None:
    """What a dotted name stands for, followed through the imports of packages.

    Returns:
        None for what is no class and no function, or stands neither in this project nor in one of
        the `LIBRARIES`.
    """
    module, source = _module(name.split("."))
    rest = name[len(module) + 1 :]
    if source is None or not rest or "." in rest:
        return None
    for each in _top(source.body):
        if isinstance(each, ast.ClassDef | ast.FunctionDef) and each.name == rest:
            return Definition(each, module, source)
        if isinstance(each, ast.ImportFrom) and each.module and not each.level:
            for alias in each.names:
                if (alias.asname or alias.name) == rest:
                    return defined(f"{each.module}.{alias.name}")
    return None


def assigned(name: str, source: ast.Module) -> Annotation | None:
    """What stands behind a name at the top of a module, or of the one it is imported from."""
    for each in _top(source.body):
        if isinstance(each, ast.Assign) and ast.unparse(each.targets[0]) == name:
            return Annotation(each.value, source)
        if isinstance(each, ast.ImportFrom) and each.module and not each.level:
            for alias in each.names:
                if (alias.asname or alias.name) == name:
                    package, other = _module([*each.module.split("."), alias.name])
                    found = None if package != each.module or other is None else other
                    return None if found is None else assigned(alias.name, found)
    return None


def _top(body: Sequence[ast.stmt]) -> Iterator[ast.stmt]:
    """Statements of a module, those under `if TYPE_CHECKING:` and `with needs(...):` as well."""
    for each in body:
        if isinstance(each, ast.If | ast.With):
            yield from _top(each.body)
        else:
            yield each


def _module(parts: Sequence[str]) -> tuple[str, ast.Module | None]:
    """The longest beginning of a dotted name that is a module, and its source."""
    for length in range(len(parts) - 1, 0, -1) if parts[0] in (*PROJECT, *LIBRARIES) else ():
        source = _source(".".join(parts[:length]))
        if source is not None:
            return ".".join(parts[:length]), source
    return "", None


@cache
def _source(module: str) -> ast.Module | None:
    first, *rest = module.split(".")
    package = find_spec(first)
    folders = [] if package is None else package.submodule_search_locations or []
    for place in (Path(folder, *rest) for folder in folders):
        for file in (place.with_suffix(".py"), place / "__init__.py"):
            if file.is_file():
                return ast.parse(file.read_text(encoding="utf-8"))
    return None
