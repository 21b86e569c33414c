"""The direction of imports never turns back.

Each part imports what its layer allows and nothing else.
"""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
BASE = {"checks", "smooth", "types", "geometry"}
# what a part of the package may import besides itself
ALLOWED = {
    "__init__": set(),
    "commands": {"metrics", "reporting", "vehicles"},
    "online": {"checks", "data", "device_checks", "geometry", "planning", "stack", "types"},
    "crowdnav": {"checks", "dynamics", "simulation", "vehicles"},
    "device_checks": set(),
    "reporting": set(),
    "checks": set(),
    "smooth": set(),
    "seeding": set(),
    "types": {"checks"},
    "geometry": {"types"},
    "vehicles": {"checks", "smooth"},
    "dynamics": BASE | {"vehicles"},
    "costs": BASE,
    "control": {"checks", "types"},
    "prediction": BASE | {"dynamics"},
    "planning": BASE | {"dynamics", "costs", "control"},
    "metrics": {"checks", "seeding", "types", "geometry"},
    "data": {"checks", "types", "geometry"},
    "plotting": {"types", "geometry"},
    "stack": {"checks", "types", "prediction", "planning", "metrics"},
    "callbacks": {"checks", "types", "metrics", "plotting"},
    "identification": {"checks", "types", "geometry", "vehicles", "dynamics", "costs", "control"},
    "simulation": {"checks", "seeding", "types", "geometry"}
    | {"dynamics", "prediction", "planning", "metrics"},
}
OURS = {"dmmv_conventions", "data_converters", "diffstack_mmv", "scripts"}
# what is missing, how far something is, what is imported when, and files that are written whole
EVERYBODYS = {f"dmmv_conventions.{name}" for name in ("disk", "extras", "on_demand", "progress")}
# who takes what from the conventions; all others find modes and checks in `types` and `checks`
CONVENTIONS = {
    "checks": {"dmmv_conventions.checks"},
    "device_checks": {"dmmv_conventions.checks"},
    "online": {"dmmv_conventions.observed"},
    "types": {"dmmv_conventions.modes"},
    "control": {"dmmv_conventions.libraries"},
    "planning": {"dmmv_conventions.libraries"},
    "prediction": {"dmmv_conventions.libraries"},
    "identification": {"dmmv_conventions.archives"},
    "simulation": {"dmmv_conventions.archives", "dmmv_conventions.libraries"},
    "reporting": {"dmmv_conventions.archives", "dmmv_conventions.yaml_files"},
    "dynamics": {"dmmv_conventions.config_files", "dmmv_conventions.configs"},
    "crowdnav": {
        "dmmv_conventions.config_files",
        "dmmv_conventions.configs",
        "dmmv_conventions.versions",
    },
    "data": {"dmmv_conventions.cache", "dmmv_conventions.data_names", "dmmv_conventions.opening"},
    "commands": {
        "dmmv_conventions.annotations",
        "dmmv_conventions.arguments",
        "dmmv_conventions.bars",
        "dmmv_conventions.cache",
        "dmmv_conventions.checks",
        "dmmv_conventions.config_files",
        "dmmv_conventions.configs",
        "dmmv_conventions.data_names",
        "dmmv_conventions.definitions",
        "dmmv_conventions.differences",
        "dmmv_conventions.foretold",
        "dmmv_conventions.locks",
        "dmmv_conventions.modes",
        "dmmv_conventions.pretrained",
        "dmmv_conventions.targets",
        "dmmv_conventions.versions",
        "dmmv_conventions.yaml_files",
    },
    "vehicles": {
        "dmmv_conventions.checks",
        "dmmv_conventions.config_files",
        "dmmv_conventions.configs",
        "dmmv_conventions.modes",
        "dmmv_conventions.yaml_files",
    },
    "stack": {
        "dmmv_conventions.checkpoints",
        "dmmv_conventions.differences",
        "dmmv_conventions.memory",
        "dmmv_conventions.pretrained",
        "dmmv_conventions.targets",
    },
    "callbacks": {
        "dmmv_conventions.checkpoints",
        "dmmv_conventions.differences",
        "dmmv_conventions.versions",
    },
}


def imported(path):
    """Dotted names that a file imports."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""


def ours(file):
    """Names of our own packages that a file imports, split at the dots."""
    names = [name.split(".") for name in imported(ROOT / file)]
    return [name for name in names if name[0] in OURS]


def files(folder):
    return sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / folder).rglob("*.py"))


@pytest.mark.parametrize("file", files("diffstack_mmv"))
def test_a_part_imports_only_what_its_layer_allows(file):
    part = Path(file).parts[1].removesuffix(".py")
    parts = {name[1] for name in ours(file) if name[0] == "diffstack_mmv" and len(name) > 1}
    assert parts - {part} <= ALLOWED[part]


# the conventions lie below everything: what both sides need, so that neither imports the other
@pytest.mark.parametrize(
    ("file", "allowed"),
    [(file, {"dmmv_conventions"}) for file in files("dmmv_conventions")]
    + [(file, {"dmmv_conventions", "data_converters"}) for file in files("data_converters")]
    + [(file, {"dmmv_conventions", "diffstack_mmv"}) for file in files("diffstack_mmv")],
)
def test_packages_meet_in_the_conventions_only(file, allowed):
    assert {name[0] for name in ours(file)} <= allowed


@pytest.mark.parametrize("file", files("diffstack_mmv"))
def test_only_base_parts_and_the_data_lie_on_the_conventions(file):
    part = Path(file).parts[1].removesuffix(".py")
    taken = {".".join(name) for name in ours(file) if name[0] == "dmmv_conventions"}
    assert taken <= CONVENTIONS.get(part, set()) | EVERYBODYS


@pytest.mark.parametrize(
    "module", ["cache", "checks", "configs", "disk", "extras", "modes", "progress", "versions"]
)
def test_plain_conventions_need_no_other_package(module):
    names = {name.split(".")[0] for name in imported(ROOT / "dmmv_conventions" / f"{module}.py")}
    assert names <= {"dmmv_conventions", *sys.stdlib_module_names}
