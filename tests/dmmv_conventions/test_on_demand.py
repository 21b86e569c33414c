"""Names of a package that come when somebody asks for them."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dmmv_conventions.on_demand import on_demand

ROOT = Path(__file__).resolve().parents[2]
LISTS = """
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fractions import Fraction
    from statistics import mean, median
"""


@pytest.fixture
def listed(tmp_path):
    source = tmp_path / "__init__.py"
    source.write_text(LISTS)
    return str(source)


def test_a_name_comes_from_the_module_that_the_list_tells_and_stays(listed):
    taken = on_demand(__name__, listed, "stack")
    here = sys.modules[__name__]
    try:
        assert taken("median")([1, 2, 9]) == 2
        assert here.median is taken("median")
    finally:
        del here.median


@pytest.mark.parametrize(
    ("module", "name", "error", "told"),
    [
        ("statistics", "variance", AttributeError, "'package' has no attribute 'variance'"),
        ("no_such_one", "mean", ModuleNotFoundError, r"`no_such_one` must .* '.\[stack\]'"),
        ("package.mean", "mean", ValueError, "`mean` must not be the name of its module"),
    ],
    ids=["not in the list", "not installed", "hidden by its module"],
)
def test_a_name_that_cannot_come_is_told(tmp_path, module, name, error, told):
    source = tmp_path / "__init__.py"
    source.write_text(LISTS.replace("statistics", module))
    with pytest.raises(error, match=told):
        on_demand("package", str(source), "stack")(name)


@pytest.mark.parametrize("package", ["diffstack_mmv.data", "diffstack_mmv.stack"])
def test_every_public_name_of_the_packages_can_be_had(package):
    module = importlib.import_module(package)
    assert [name for name in module.__all__ if getattr(module, name, None) is None] == []


SETTINGS = {
    "diffstack_mmv.data import WindowSettings, Situations, Mirror": "trajdata",
    "diffstack_mmv.data import ExportSettings, LoaderSettings, EqualModes": "pytorch_lightning",
    "diffstack_mmv.stack import LossWeights, PhysicsLearning": "pytorch_lightning",
    "diffstack_mmv.stack import MixedPrecision, ScaledByProcesses": "pytorch_lightning",
}


@pytest.fixture(scope="module")
def brought():
    """Whether each of `SETTINGS` has brought what it must not, after another in one process."""
    lines = [
        f"from {names}; print({absent!r} in sys.modules)" for names, absent in SETTINGS.items()
    ]
    command = [sys.executable, "-c", "\n".join(["import sys", *lines])]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    told = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return dict(zip(SETTINGS, told.stdout.split(), strict=True))


@pytest.mark.parametrize("names", SETTINGS)
def test_settings_come_without_what_the_work_needs(names, brought):
    assert brought[names] == "False"
