"""The core of the package runs without the packages of the stack, and what needs them says so."""

import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# an import of these fails as if they were not installed
REFUSE = "import sys; sys.modules |= dict.fromkeys({names})\n"
USED_BY_TORCH = {"filelock", "jinja2", "numpy"}

CORE = """
import torch, gymnasium
from diffstack_mmv.control import ILQR
from diffstack_mmv.crowdnav import CrowdNav
from diffstack_mmv.dynamics import DiffGM3, rollout
from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.simulation import CrowdNavEnv
from diffstack_mmv.vehicles import load_vehicle, save_vehicle
import diffstack_mmv.costs, diffstack_mmv.identification, diffstack_mmv.metrics
import diffstack_mmv.planning, diffstack_mmv.prediction

bicycle = load_vehicle("bicycle")
save_vehicle(bicycle, sys.argv[1])
assert load_vehicle(sys.argv[1]) == bicycle
model = DiffGM3(bicycle, dt_s=0.1)
state = torch.zeros(1, 8); state[:, 2] = 3.0
controls = torch.zeros(1, 4, 2)
cost = lambda x, u: (x[..., 0] - 2.0).square() + u.square().sum(-1)
solution = ILQR(max_iterations=3)(model, cost, model.bounds, state, controls)
solution.states[:, -1, 0].sum().backward()
assert any(each.grad is not None for each in model.parameters())
env = gymnasium.make("diffstack_mmv/CrowdNav-v0", robot="bicycle", dynamics="kbm")
env.reset(options={"phase": "test", "case": 7})
env.step(env.action_space.sample())
with open(sys.argv[1], "w") as file:
    file.write("mass_kg: 90.0\\nheight_m: ${mass_kg}\\n")
try:
    load_vehicle(sys.argv[1])
except ModuleNotFoundError as missing:
    print(missing)
assert CrowdNav(limit_s=0.25).drive([7])["n"] == 1
"""


def refused():
    """Import names of the packages that the extra `stack` brings and the core does not."""
    stack = PROJECT["optional-dependencies"]["stack"]
    wanted = {re.split("[<>=]", each)[0].replace("_", "-") for each in stack}
    found = {
        module
        for module, packages in packages_distributions().items()
        if wanted & {each.lower().replace("_", "-") for each in packages}
    }
    return found - USED_BY_TORCH


def without_the_stack(code, *arguments):
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", REFUSE.format(names=refused()) + code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)


def test_the_extra_is_read_from_the_project():
    assert {"trajdata", "pytorch_lightning", "hydra", "omegaconf", "pandas", "scipy"} <= refused()
    assert not refused() & {"torch", "gymnasium", "yaml", "jaxtyping"}


def test_the_core_solves_differentiates_and_drives_without_the_stack(tmp_path):
    done = without_the_stack(CORE, str(tmp_path / "mine.yaml"))
    assert done.returncode == 0, done.stderr
    assert "`omegaconf` must be installed for `${...}` in" in done.stdout


# module, or a name of one that imports its names on demand -> what is told to need the extra
PARTS = {
    "diffstack_mmv.data:TrajdataModule": "diffstack_mmv.data",
    "diffstack_mmv.stack:DiffStackMMV": "diffstack_mmv.stack",
    "diffstack_mmv.callbacks": "diffstack_mmv.callbacks",
    "diffstack_mmv.plotting": "diffstack_mmv.plotting",
    "diffstack_mmv.reporting": "diffstack_mmv.reporting",
    "data_converters:ThabVruDataset": "data_converters",
    "data_converters:ImptcDataset": "data_converters.imptc",
    "diffstack_mmv.metrics:MeanByMode": "diffstack_mmv.metrics",
    "diffstack_mmv.commands.cli": "the command lines",
    "scripts.train": "the command lines",
    "diffstack_mmv.simulation.drawing": "pictures of the environment",
}


def test_parts_of_the_stack_name_the_extra():
    code = """
import importlib
for part in {parts}:
    try:
        module, _, name = part.partition(":")
        found = importlib.import_module(module)
        getattr(found, name or "__name__")
    except (ModuleNotFoundError, SystemExit) as missing:
        print(missing)
    else:
        print("imported")
"""
    told = without_the_stack(code.format(parts=list(PARTS))).stdout.splitlines()
    for part, line in zip(PARTS.values(), told, strict=True):
        assert f"must be installed for {part}, but got nothing of that name. Run: pip" in line
        assert line.endswith("'diffstack_mmv[stack]', in a checkout: '.[stack]'")


COMMANDS = sorted(
    path.name for path in (ROOT / "scripts").glob("*.py") if "@command" in path.read_text()
)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_of_a_checkout_says_in_one_line_what_is_missing(name):
    run = f"import runpy; runpy.run_path('scripts/{name}', run_name='__main__')"
    done = without_the_stack(run)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("`hydra` must be installed for the command lines, but got nothing")


@pytest.mark.parametrize(
    ("extra", "package", "script", "arguments"),
    [
        ("sweep", "submitit", "results", ["launcher=slurm"]),
        ("dashboard", "wandb_workspaces", "dashboard", ["entity=team"]),
        ("crowd", "pysocialforce", "navigate", ["crowd=social_force", "cases=1", "beside=[]"]),
    ],
)
def test_a_command_names_the_extra_of_a_part(
    extra, package, script, arguments, refusal, monkeypatch, tmp_path
):
    monkeypatch.setitem(sys.modules, package, None)
    told = refusal(script, *arguments, f"out={tmp_path}")
    assert f"`{package}` must be installed" in told
    assert f"diffstack_mmv[{extra}]" in told


@pytest.mark.parametrize("extra", ["dashboard", "sweep", "test"])
def test_extras_bring_the_stack_they_need(extra):
    assert "diffstack_mmv[stack]" in PROJECT["optional-dependencies"][extra]
