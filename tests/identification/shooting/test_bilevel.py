"""The tracking problem as an inner problem of differentiable MPC."""

import torch

from diffstack_mmv.control import ILQR
from diffstack_mmv.identification import BilevelFit, infer_controls
from diffstack_mmv.identification.shooting.bilevel import with_unmeasured_start
from diffstack_mmv.identification.shooting.problem import Measurements, TrackingProblem, Unknowns
from tests.identification.conftest import LAZY, LIVELY, synthetic_problem


def rows_of(problem, rows):
    """The tracks `rows` of a problem."""
    measurements = Measurements(*(part[rows] for part in problem.measurements))
    guess = Unknowns(*(part[rows] for part in problem.guess))
    return TrackingProblem(measurements, problem.start[rows], guess)


def test_inner_problem_has_the_solution_of_multiple_shooting():
    setup = synthetic_problem("kbm", {}, manoeuvres=LIVELY[2:])
    simulator, tracks = setup.simulator, setup.data.fitted
    theta = simulator.parameters.start()
    shot = infer_controls(simulator, theta, tracks, tracks.guess)
    inner = BilevelFit().solve(simulator, tracks, theta, tracks.guess)
    torch.testing.assert_close(inner.solution.cost, shot.simulated.cost, rtol=1e-4, atol=0.0)


def test_solution_of_a_track_does_not_depend_on_those_that_finish_earlier():
    """Ten tracks are narrowed to the hard ones; the answer is that of each alone."""
    setup = synthetic_problem("kbm", {}, manoeuvres=(LIVELY[1], *LAZY * 5))
    simulator, tracks = setup.simulator, setup.data.fitted
    theta = simulator.parameters.start().requires_grad_()
    fit = BilevelFit(solver=ILQR(max_iterations=30))
    together = fit.solve(simulator, tracks, theta, tracks.guess).solution
    (gradient,) = torch.autograd.grad(together.cost[0], theta)
    first = rows_of(tracks, slice(0, 1))
    alone = fit.solve(simulator, first, theta, first.guess).solution
    (expected,) = torch.autograd.grad(alone.cost[0], theta)
    assert int(together.iterations.min()) < int(together.iterations.max())
    torch.testing.assert_close(together.cost[:1], alone.cost)
    torch.testing.assert_close(together.controls[:1], alone.controls)
    torch.testing.assert_close(gradient, expected)


def test_time_before_the_first_step_weighs_nothing():
    measurements = synthetic_problem("kbm", {}, manoeuvres=LAZY).data.fitted.measurements
    earlier = with_unmeasured_start(measurements)
    assert not bool(earlier.weight[:, 0].any())
    assert not bool(earlier.control_weight[:, 0].any())
    torch.testing.assert_close(earlier.position[:, 1:], measurements.position)
    torch.testing.assert_close(earlier.weight[:, 1:], measurements.weight)
