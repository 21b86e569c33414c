"""Packages whose names are imported when somebody asks for them, each with its own module.

Settings are then checked without what only the work needs (PEP 562).
"""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from dmmv_conventions.extras import needs


def on_demand(package: str, source: str, extra: str) -> Callable[[str], Any]:
    """The `__getattr__` of a package whose `__init__` lists its names for type checkers alone.

    The list is what stands under `if TYPE_CHECKING:`, and is read from there, so that there is one.

    Args:
        package: The `__name__` of the package.
        source: Its `__file__`.
        extra: What the package needs to be installed, see `needs`.

    Raises:
        ValueError: A name is that of a module of the package, which would take its place as soon as
            it is imported.
    """
    places = _listed(Path(source))
    for name, place in places.items():
        if place == f"{package}.{name}":
            raise ValueError(f"`{name}` must not be the name of its module, but got {place}.")

    def taken(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name)
        with needs(extra, package):
            found = getattr(import_module(places[name]), name)
        setattr(sys.modules[package], name, found)
        return found

    return taken


def _listed(source: Path) -> dict[str, str]:
    """Name -> module of all that is imported under `if TYPE_CHECKING:`."""
    body = ast.parse(source.read_text(encoding="utf-8")).body
    guarded = [
        line
        for node in body
        if isinstance(node, ast.If)
        and isinstance(node.test, ast.Name)
        and node.test.id == "TYPE_CHECKING"
        for line in node.body
    ]
    imports = [line for line in guarded if isinstance(line, ast.ImportFrom)]
    return {alias.name: line.module or "" for line in imports for alias in line.names}
