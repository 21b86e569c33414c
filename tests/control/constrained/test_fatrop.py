"""The constrained drives posed to fatrop are those posed to IPOPT."""

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from diffstack_mmv.control.constrained.local import rollout
from tests.control.constrained import problems

casadi = pytest.importorskip("casadi", reason="the peers of the benchmark are not installed")
if not casadi.has_nlpsol("fatrop"):
    pytest.skip("this build of CasADi has no fatrop", allow_module_level=True)
sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "benchmarks"))


def test_fatrop_and_ipopt_find_the_same_drive():
    from peers.fatrop_drives import by_fatrop

    from tests.control.constrained.reference import by_ipopt

    drive = problems.drives(1)
    guess = problems.braking(drive)
    states = rollout(lambda x, u: problems.step(x, u, drive.wheelbase), drive.state, guess).numpy()
    found, expected = (
        solve(drive, 0, guess[0].numpy(), states[0]) for solve in (by_fatrop, by_ipopt)
    )
    assert found.solved
    assert found.cost == pytest.approx(expected.cost, rel=1e-5)
    np.testing.assert_allclose(found.states, expected.states, atol=1e-2)
    assert torch.tensor(found.controls).abs().amax(0).le(torch.tensor(problems.BOX[1]) + 1e-6).all()
