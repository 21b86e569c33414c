"""How the value of a constraint is weighed against its multiplier, whatever their units are."""

import pytest
import torch

from diffstack_mmv.control import Batched, Bounds
from diffstack_mmv.control.constrained import Inequality
from diffstack_mmv.control.constrained.constraint import gather
from diffstack_mmv.control.constrained.local import Problem
from diffstack_mmv.control.constrained.phases import activation_weight

pytestmark = pytest.mark.usefixtures("double")
BOX = Bounds(-torch.ones(1), torch.ones(1))


def weights(cost, *limits):
    """κ of constraints on the place of a point that moves as it is told, alike in two problems."""

    def step(state, control):
        return state + control

    state, controls = torch.ones(2, 1), torch.full((2, 4, 1), 0.5)
    rows = gather([Inequality(each) for each in limits], torch.ones(2, 5, 1), controls)
    problem = Problem(Batched(step), cost, rows, BOX, state)
    found = activation_weight(problem, problem.rollout(controls), controls)
    assert found.shape == (2, 1, len(limits))
    assert torch.equal(found[0], found[1])
    return found[0, 0].tolist()


def valley(scale):
    """Curved by 6 in the state and by 2 in the control, times a scale."""
    return lambda x, u: scale * (3 * x[..., 0].square() + u[..., 0].square())


def wall(slope):
    return lambda x, u: slope * (x[..., :1] - 2)


@pytest.mark.parametrize("scale", [1.0, 7.0])
@pytest.mark.parametrize("slope", [1.0, -3.0])
def test_a_constraint_counts_as_much_as_it_is_curved_with_the_cost(scale, slope):
    assert weights(valley(scale), wall(slope)) == pytest.approx([8 * scale / slope**2])


def test_the_slope_by_the_control_counts_as_that_by_the_state():
    found = weights(valley(1.0), lambda x, u: 0.3 * x - 0.4 * u, lambda x, u: -0.1 * u)
    assert found == pytest.approx([8 / 0.25, 8 / 0.01])


def test_the_steepest_time_of_a_constraint_is_what_counts():
    """The point is at 1, 1.5, ... 3, where the square of the place has the slope 6."""
    assert weights(valley(1.0), lambda x, u: x.square() - 4) == pytest.approx([8 / 36])


def test_a_constraint_that_hardly_moves_counts_as_one_of_a_hundredth_of_the_steepest():
    found = weights(valley(1.0), wall(2.0), wall(1e-4))
    assert found == pytest.approx([8 / 4, 8 / 0.04])


@pytest.mark.parametrize(
    ("cost", "limit"),
    [
        (lambda x, u: x[..., 0] + u[..., 0], wall(5.0)),
        (valley(1.0), lambda x, u: 0 * x[..., :1] + 0 * u),
    ],
    ids=["a cost that is not curved", "a constraint that does not move"],
)
def test_without_anything_to_go_by_the_weight_is_one(cost, limit):
    assert weights(cost, limit) == [1.0]
