"""What every planner of `configs/` promises, in training and in closed loop, for every dynamics."""

import copy
from dataclasses import replace
from functools import cache
from itertools import product

import pytest
import torch
import yaml
from hydra.utils import instantiate

from diffstack_mmv.planning import Planner, PlannerState, build_problem, straight_reference
from diffstack_mmv.types import Discs, Ego, HeadingOf, Motion, Obstacles, PlanOrigin, map_tensors
from diffstack_mmv.vehicles import config_folder
from tests.simulation.conftest import composed_navigate
from tests.test_configs import composed

DYNAMICS = ("unicycle", "kbm", "gm3")


SLOW = pytest.mark.slow


def options(group):
    return sorted(path.stem for path in (config_folder() / group).glob("*.yaml"))


CONTROLLERS = options("controller")


def planner_of_training(name, dynamics):
    few = ["horizon_s=1.0", "solver.max_iterations=4"]
    config = composed("train", f"planner={name}", f"dynamics={dynamics}", *few)
    planner = instantiate(config.stack.planner)
    return planner(dynamics=instantiate(config.stack.dynamics))


def planner_of_controller(name, dynamics):
    few = ["controller.planner.solver.max_iterations=4", "controller.planner.steps=8"]
    config = composed_navigate(f"controller={name}", f"dynamics={dynamics}", *few)
    return instantiate(config.controller.planner)


def controllers_that_plan():
    """Those with a planner, their own or inherited; told by the files, as composing takes long."""
    folder = config_folder() / "controller"
    files = {name: yaml.safe_load((folder / f"{name}.yaml").read_text()) for name in CONTROLLERS}

    def plans(name):
        return "planner" in files[name] or any(
            plans(other) for other in files[name].get("defaults", []) if other in CONTROLLERS
        )

    return [name for name in CONTROLLERS if plans(name)]


# presets of one controller, which differ in settings: all of them in the slow tests
PRESETS = {"diffmpc_adaptive", "diffmpc_delay", "diffmpc_tracking"}
CASES = [(planner_of_training, *case) for case in product(options("planner"), DYNAMICS)]
# a vehicle of the closed loop is driven by an acceleration and an angle, not as a unicycle
CASES += [(planner_of_controller, name, "kbm") for name in controllers_that_plan()]
CASES += [(planner_of_controller, "diffmpc", "gm3")]


@cache
def build(source, name, dynamics):
    return source(name, dynamics)


@pytest.fixture(
    params=[pytest.param(case, marks=SLOW if case[1] in PRESETS else []) for case in CASES],
    ids=lambda case: f"{case[1]}-{case[2]}",
)
def planner(request):
    return build(*request.param)


def problem(planner, batch=2, neighbors=1):
    zero = torch.zeros(batch)
    motion = Motion(torch.zeros(batch, 2), zero, torch.stack([zero + 2, zero], -1), zero)
    goal = torch.tensor([4.0, 0.5]).repeat(batch, 1)
    steps = planner.steps
    path = torch.tensor([3.0, 1.5]).expand(batch, neighbors, 2, steps + 1, 2)
    weight = torch.full((batch, neighbors, 2), 0.5)
    size = torch.full((batch, neighbors), 0.3)
    ego = Ego(motion, HeadingOf.BODY, Discs(zero[:, None], zero[:, None] + 0.3))
    reference = straight_reference(motion, goal, steps, 2.0)
    return build_problem(ego, goal, reference, Obstacles(path, weight, size, size > 0))


def memory(planner, batch=2):
    controls = torch.zeros(batch, planner.steps, planner.dynamics.control_dim)
    return PlannerState(controls, torch.zeros(batch))


@pytest.mark.parametrize(
    ("neighbors", "remembers"),
    [(0, False), (2, True), pytest.param(0, True, marks=SLOW), pytest.param(2, False, marks=SLOW)],
)
def test_a_plan_is_the_motion_of_its_admissible_controls(planner, neighbors, remembers):
    assert isinstance(planner, Planner)
    model = planner.dynamics
    with torch.no_grad():
        plan = planner(
            problem(planner, neighbors=neighbors), memory(planner) if remembers else None
        )
    assert plan.controls.shape == (2, planner.steps, model.control_dim)
    assert plan.motion.position.shape == (2, planner.steps + 1, 2)
    assert plan.controls.isfinite().all()
    assert torch.allclose(model.within_bounds(plan.controls), plan.controls, atol=1e-6)
    assert torch.allclose(plan.motion.position[:, 0], torch.zeros(2, 2), atol=1e-5)
    assert set(plan.origin.tolist()) <= set(PlanOrigin)


def test_a_plan_comes_closer_to_its_goal(planner):
    asked = problem(planner, neighbors=0)
    with torch.no_grad():
        position = planner(asked, memory(planner)).motion.position
    way = (position - asked.goal[:, None]).norm(dim=-1)
    assert (way.amin(-1) < 0.6 * way[:, 0]).all()


def asked_of_three(planner):
    """Three problems, of which the middle one has another goal."""
    asked = problem(planner, batch=3)
    asked.goal[1] = torch.tensor([2.0, -2.0])
    return asked


def test_problems_do_not_see_their_batch_mates(planner, double):
    planner = copy.deepcopy(planner).double()
    asked = asked_of_three(planner)
    alike = map_tensors(lambda entry: entry[1:2].expand_as(entry).clone(), asked)
    with torch.no_grad():
        one, other = (planner(each, memory(planner, 3)).controls[1] for each in (asked, alike))
    assert torch.equal(one, other)


def test_a_problem_alone_has_the_plan_that_it_has_in_a_batch(planner, double):
    """Converged: before, differenced curvatures multiply the rounding of a batch by up to 1e10."""
    planner = copy.deepcopy(planner).double()
    planner.solver = replace(planner.solver, max_iterations=20)
    asked = asked_of_three(planner)
    with torch.no_grad():
        together = planner(asked, memory(planner, 3)).controls[1]
        row = map_tensors(lambda entry: entry[1:2], asked)
        alone = planner(row, memory(planner, 1)).controls[0]
    assert torch.allclose(together, alone, atol=1e-6)
