"""Whether what a configuration gives to a part has the type that the part is written with.

Annotations are read from the sources, and nothing is imported. What stands for a class of its own,
an array or a variable of types, is for the part itself to judge.
"""

import ast
from collections.abc import Iterator, Mapping
from typing import Any

from dmmv_conventions.checks import message
from dmmv_conventions.definitions import Annotation, assigned, defined
from dmmv_conventions.targets import parts

_PLAIN = {
    "int": (int, "a whole number"),
    "float": (int | float, "a number"),
    "bool": (bool, "true or false"),
    "str": (str, "text"),
    "list": (list, "a list"),
    "tuple": (list, "a list"),
    "dict": (Mapping, "settings, each with its name"),
}
"""What a configuration holds, with the types that it may have and its name in a message."""


def require_types(content: Any) -> None:
    """Refuse values of another type than that of the argument; nothing is imported.

    Constructors of Lightning and of torch are judged, whose arguments are not all in the
    configuration; those of this project judge themselves, but for lists, which few comparisons with
    a number survive. A whole number may stand for a fraction, a part that is still to be built for
    anything.

    Args:
        content: Plain containers; interpolations have to be resolved.

    Raises:
        ValueError: A value cannot be what its argument is annotated with.
    """
    for place, node in parts(content):
        found = defined(str(node["_target_"]))
        if found is None:
            continue
        judges_itself = found.is_own and (found.constructor() or any(found.fields()))
        for name, annotation in found.annotations():
            if name not in node or (judges_itself and not isinstance(node[name], list)):
                continue
            if fits(node[name], annotation) is False:
                key = f"{place}.{name}".lstrip(".")
                wanted = f"be {' or '.join(dict.fromkeys(_told(annotation)))}"
                raise ValueError(message(key, wanted, repr(node[name]), "in the configuration"))


def fits(value: Any, annotation: Annotation) -> bool | None:
    """Whether a plain value may stand for an annotated argument.

    Returns:
        None where the annotation has a part that only the argument itself can judge.
    """
    if isinstance(value, Mapping) and "_target_" in value:
        return None
    answers = {_is(value, part) for part in _alternatives(annotation)}
    return next((answer for answer in (True, None) if answer in answers), False)


def _is(value: Any, part: Annotation) -> bool | None:
    """`fits` for one alternative."""
    wanted = part.node
    if isinstance(wanted, ast.Constant):
        return type(value) is type(wanted.value) and value == wanted.value
    name = _name(wanted)
    if name not in _PLAIN:
        return None
    if (isinstance(value, bool) and name != "bool") or not isinstance(value, _PLAIN[name][0]):
        return False
    if name != "list" or not isinstance(wanted, ast.Subscript):
        return True
    answers = {fits(each, part.of(wanted.slice)) for each in value}
    return next((answer for answer in (False, None) if answer in answers), True)


def _name(node: ast.expr) -> str:
    """The name of a type without the module in front of it and what it holds."""
    whole = node.value if isinstance(node, ast.Subscript) else node
    return whole.attr if isinstance(whole, ast.Attribute) else ast.unparse(whole)


def _alternatives(annotation: Annotation) -> Iterator[Annotation]:
    """What a union, a list of literals or another name for a type stands for."""
    node = annotation.node
    name = _name(node)
    if isinstance(node, ast.Subscript) and name == "Literal":
        yield from map(annotation.of, _listed(node.slice))
    elif isinstance(node, ast.Subscript) and name in ("Optional", "Union"):
        more = [ast.Constant(None)] if name == "Optional" else []
        for each in [*_listed(node.slice), *more]:
            yield from _alternatives(annotation.of(each))
    elif isinstance(node, ast.BinOp):
        for each in (node.left, node.right):
            yield from _alternatives(annotation.of(each))
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):  # a type in quotes
        yield from _alternatives(annotation.of(ast.parse(node.value, mode="eval").body))
    else:
        meant = None if name in _PLAIN else assigned(name, annotation.source)
        yield from [annotation] if meant is None else _alternatives(meant)


def _listed(inside: ast.expr) -> list[ast.expr]:
    """What stands between brackets."""
    return inside.elts if isinstance(inside, ast.Tuple) else [inside]


def _told(annotation: Annotation) -> Iterator[str]:
    """The alternatives as a message names them; those of unknown types are left out."""
    for each in _alternatives(annotation):
        if isinstance(each.node, ast.Constant):
            yield "null" if each.node.value is None else str(each.node.value)
        elif _name(each.node) in _PLAIN:
            yield _PLAIN[_name(each.node)][1]
