"""Against IPOPT: solutions, and their sensitivities by central differences of its solutions."""

import numpy as np
import pytest
import torch

from diffstack_mmv.control import ILQR
from diffstack_mmv.control.constrained import ConstrainedILQR
from tests.control.constrained.problems import braking, drives, solve

pytest.importorskip("casadi", reason="IPOPT comes with CasADi, see the extra `test`")
pytestmark = pytest.mark.usefixtures("double")


@pytest.mark.slow
def test_solutions_and_sensitivities_are_those_of_ipopt():
    from tests.control.constrained.reference import by_ipopt

    drive = drives(2)
    radius = drive.radius.clone().requires_grad_()
    solution = solve(
        ConstrainedILQR(ILQR(tolerance=1e-16)), drive._replace(radius=radius), braking(drive)
    )
    (gradient,) = torch.autograd.grad(solution.cost.sum(), radius)
    cost = solution.cost.tolist()
    for i in range(2):
        states, controls = (
            part[i].detach().numpy() for part in (solution.states, solution.controls)
        )
        found = by_ipopt(drive, i, controls, states)
        assert found.solved
        assert found.cost == pytest.approx(cost[i], rel=1e-7)
        np.testing.assert_allclose(found.states, states, atol=1e-5)
        ends = [
            by_ipopt(drive._replace(radius=drive.radius + step), i, controls, states).cost
            for step in (1e-4, -1e-4)
        ]
        assert (ends[0] - ends[1]) / 2e-4 == pytest.approx(
            float(gradient[i].sum()), rel=1e-3, abs=1e-3
        )
