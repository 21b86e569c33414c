"""What is installed: every package of the tree, and commands that find their scripts."""

import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
INSTALLED = PROJECT["tool"]["setuptools"]
COMMANDS = PROJECT["project"]["scripts"]


def test_every_package_is_installed():
    found = {
        ".".join(path.parent.relative_to(ROOT).parts)
        for top in ("dmmv_conventions", "diffstack_mmv", "data_converters")
        for path in (ROOT / top).rglob("__init__.py")
    }
    renamed = {"diffstack_mmv_scripts", "diffstack_mmv_configs"}
    assert set(INSTALLED["packages"]) == found | renamed


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_its_script(name):
    module, function = COMMANDS[name].split(":")
    package, _, stem = module.partition(".")
    assert package in INSTALLED["packages"]
    script = ROOT / INSTALLED["package-dir"][package] / f"{stem}.py"
    assert f"def {function}(" in script.read_text()
