"""What is installed: every package of the tree, and commands that find their scripts."""

import os
import subprocess
import sys
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


def test_every_script_with_a_configuration_is_a_command():
    configured = {path.stem for path in (ROOT / "configs").glob("*.yaml")}
    scripts = {path.stem for path in (ROOT / "scripts").glob("*.py")}
    names = {name.removeprefix("dmmv-").replace("-", "_") for name in COMMANDS}
    assert configured & scripts <= names


def test_an_audit_without_its_service_says_that_nothing_was_audited(root):
    surroundings = os.environ | {"https_proxy": "http://127.0.0.1:9", "no_proxy": ""}
    command = ["sh", "scripts/audit.sh", sys.executable]
    done = subprocess.run(command, cwd=root, env=surroundings, capture_output=True, text=True)
    needs, nothing = done.stderr.splitlines()
    assert done.returncode == 1
    assert needs.startswith("make audit needs https://pypi.org/pypi/")
    assert nothing.startswith("Nothing was audited.")


@pytest.mark.parametrize("name", ["sbom", "needs_cuda"])
def test_a_script_of_make_tells_what_it_does_and_writes_nothing(name, tmp_path):
    command = [sys.executable, str(ROOT / "scripts" / f"{name}.py"), "--help"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("usage:")
    assert not list(tmp_path.iterdir())
