"""Fixtures shared by all tests: the reference data beside the project, seeds, and commands."""

import gc
import os
from pathlib import Path

import jaxtyping
import pytest
import torch
from hypothesis import HealthCheck, settings

from tests import shape_checks
from tests.running import run_here

gc.disable()  # until all tests are collected: what is imported stays
shape_checks.install()
# of the commands that log their results; the tests of that log set it anew
os.environ["WANDB_MODE"] = "disabled"

ROOT = Path(__file__).resolve().parents[1]

settings.register_profile(
    "deterministic",
    derandomize=True,
    deadline=None,
    max_examples=25,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
settings.load_profile("deterministic")


def pytest_collection_finish():
    """Leave what is imported by now out of the search for garbage, which takes a tenth of all."""
    from dmmv_conventions.memory import leave_alone

    leave_alone()
    gc.enable()


@pytest.fixture(autouse=True)
def seeded():
    """Every test starts from the same random state, and the first calls in it are checked."""
    torch.manual_seed(0)
    shape_checks.begin_test()


@pytest.fixture(autouse=True)
def logged_nowhere():
    """No test switches the log on for those after it, as the logger of Lightning does."""
    yield
    assert os.environ["WANDB_MODE"] == "disabled"


@pytest.fixture
def unchecked():
    """Let wrong shapes and types through to the messages of the package itself."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(scope="session")
def root() -> Path:
    """The folder of the project."""
    return ROOT


@pytest.fixture(scope="session")
def shared() -> Path:
    """Reference vectors and real recordings, which lie beside the project, not in it."""
    folder = ROOT.parent / "shared"
    if not folder.is_dir():
        pytest.skip("needs the reference data in ../shared, which this machine does not have")
    return folder


@pytest.fixture
def double():
    """Run a test in float64."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(before)


@pytest.fixture
def command(unchecked):
    """`run_here`, with the messages of the package itself."""
    return run_here


@pytest.fixture
def nothing_compiled():
    """What other tests compiled counts for the limit of recompilations."""
    torch._dynamo.reset()


@pytest.fixture
def succeed(command, capfd):
    """Run a command that must succeed; what it told."""

    def run(script, *arguments):
        status = command(script, *arguments)
        told = capfd.readouterr()
        assert status == 0, told.err
        return told.out

    return run


@pytest.fixture
def refusal(command, capfd):
    """Run a command that must fail with one message and no traceback; the message."""

    def run(script, *arguments):
        status = command(script, *arguments)
        told = capfd.readouterr().err
        assert status == 1, told
        assert "Traceback" not in told
        return told

    return run
