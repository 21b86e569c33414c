"""The direction of imports never turns back.

Each part imports what its layer allows and nothing else.
"""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
BASE = {"checks", "smooth", "types", "geometry"}
# what a part of the package may import besides itself
ALLOWED = {
    "__init__": set(),
    "cli": set(),
    "reporting": set(),
    "checks": set(),
    "smooth": set(),
    "types": {"checks"},
    "geometry": {"types"},
    "vehicles": {"checks", "smooth"},
    "dynamics": BASE | {"vehicles"},
    "costs": BASE,
    "control": {"checks", "types"},
    "prediction": BASE | {"dynamics"},
    "planning": BASE | {"dynamics", "costs", "control"},
    "metrics": {"checks", "types", "geometry"},
    "data": {"checks", "types", "geometry"},
    "plotting": {"types", "geometry"},
    "stack": {"checks", "types", "prediction", "planning", "metrics"},
    "callbacks": {"checks", "types", "metrics", "plotting"},
    "identification": {"checks", "types", "geometry", "vehicles", "dynamics", "costs", "control"},
    "simulation": {"checks", "types", "geometry", "dynamics", "prediction", "planning", "metrics"},
}


def imported(path):
    """Dotted names that a file imports."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""


def files(folder):
    return sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / folder).rglob("*.py"))


@pytest.mark.parametrize("file", files("diffstack_mmv"))
def test_a_part_imports_only_what_its_layer_allows(file):
    part = Path(file).parts[1].removesuffix(".py")
    names = [name.split(".") for name in imported(ROOT / file)]
    parts = {name[1] for name in names if name[0] == "diffstack_mmv" and len(name) > 1}
    assert parts - {part} <= ALLOWED[part]
    assert not {"scripts", "data_converters"} & {name[0] for name in names}


@pytest.mark.parametrize("file", files("data_converters"))
def test_converters_know_nothing_of_the_package(file):
    assert "diffstack_mmv" not in {name.split(".")[0] for name in imported(ROOT / file)}
