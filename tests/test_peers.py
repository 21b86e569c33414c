"""Solvers of the benchmarks get the problems that ours gets, and solve them."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))
from peers import driving, ours, unicycle  # noqa: E402
from peers.problems import PROBLEMS  # noqa: E402

BUILT = ROOT / "outputs" / "peers" / "bin" / "python"
STEPS, COUNT = 10, 2


def costs_of(solve, problem, given):
    """Costs of the controls that a solver returns."""
    return problem.true_cost(*given, solve(*given, STEPS, problem)())


@pytest.mark.parametrize("name", PROBLEMS)
def test_ours_fatrop_and_ipopt_find_the_same_costs(name):
    pytest.importorskip("casadi", reason="CasADi is not installed")
    problem = PROBLEMS[name]
    given = problem.instances(COUNT, STEPS)
    ipopt, fatrop = (importlib.import_module(f"peers.{each}") for each in ("ipopt", "fatrop"))
    expected = costs_of(ipopt.prepare, problem, given)
    np.testing.assert_allclose(costs_of(fatrop.prepare, problem, given), expected, rtol=1e-4)
    leaves = ours.leaves_of(given[1], torch.float64, problem)
    solution = ours.solver(given[0], leaves, STEPS, False, problem, 1e-10)()
    np.testing.assert_allclose(solution.cost.detach().numpy(), expected, rtol=1e-4)
    found = problem.true_cost(*given, ours.controls_of(solution))
    np.testing.assert_allclose(solution.cost.detach().numpy(), found, rtol=1e-10)


def test_problems_say_whether_they_have_bounds():
    assert [name for name, problem in PROBLEMS.items() if problem.bounded] == [
        "obstacle",
        "unicycle",
    ]
    assert driving.FREE.differentiated
    assert not driving.OBSTACLE.differentiated


IN_CROCODDYL = """
import json, sys
import crocoddyl, numpy as np
sys.path.insert(0, "benchmarks")
from peers import crocoddyl_unicycle, unicycle
model = crocoddyl.ActionModelUnicycle()
data = model.createData()
state, control = np.array([0.3, -0.7, 2.0]), np.array([0.5, -1.5])
model.calc(data, state, control)
told = {"next": data.xnext.tolist(), "cost": data.cost}
model.calc(data, state)
told["final"] = data.cost
for name, problem in (("boxed", unicycle.BOXED), ("free", unicycle.FREE)):
    given = problem.instances(2, 10)
    controls = crocoddyl_unicycle.prepare(*given, 10, problem)()
    told[name] = problem.true_cost(*given, controls).tolist()
print(json.dumps(told))
"""


@pytest.mark.skipif(not BUILT.exists(), reason="no environment of the peers: `make peers`")
def test_crocoddyls_own_unicycle_is_ours():
    done = subprocess.run(
        [BUILT, "-c", IN_CROCODDYL], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if "No module named 'crocoddyl'" in done.stderr:
        pytest.skip("crocoddyl could not be installed")
    told = json.loads(done.stdout.splitlines()[-1])
    problem, goal = unicycle.FREE, (0.0, 0.0, 0.0)
    state, control = (0.3, -0.7, 2.0), (0.5, -1.5)
    np.testing.assert_allclose(problem.step(np, state, control), told["next"], rtol=1e-12)
    assert problem.stage_cost(np, state, control, goal) == pytest.approx(told["cost"], rel=1e-12)
    assert problem.final_cost(np, state, goal) == pytest.approx(told["final"], rel=1e-12)
    for name, each in (("boxed", unicycle.BOXED), ("free", unicycle.FREE)):
        given = each.instances(2, STEPS)
        leaves = ours.leaves_of(given[1], torch.float64, each)
        solution = ours.solver(given[0], leaves, STEPS, False, each, 1e-10)()
        np.testing.assert_allclose(solution.cost.detach().numpy(), told[name], rtol=1e-4)
