"""Errors on segments that were held out."""

import pytest
import torch

from diffstack_mmv.identification import Identifier, ValidationErrors, validation_errors
from diffstack_mmv.identification.inference.validation import drop_last_samples
from diffstack_mmv.identification.shooting.tracking import infer_controls
from tests.identification.conftest import synthetic_problem


def errors(*values):
    column = torch.tensor(values)
    return ValidationErrors(
        tuple("abcd"[: len(values)]), column, torch.ones(len(values)), 2 * column
    )


def test_what_is_predicted_is_not_used():
    setup = synthetic_problem("kbm", {}, known=False)
    heldout = setup.data.heldout
    moved = heldout.measurements.position.clone()
    moved[:, -5:] += 7.0
    other = heldout._replace(measurements=heldout.measurements._replace(position=moved))
    found = Identifier()(setup.simulator, setup.data)
    near, far = (
        validation_errors(
            setup._replace(data=setup.data._replace(heldout=each)), found, Identifier(), 5
        ).prediction
        for each in (heldout, other)
    )
    assert float(far) == pytest.approx(7 * 2**0.5, abs=float(near))
    assert float(near) < 2.0


def test_recorded_controls_of_what_is_predicted_are_not_used():
    """The control beside a sample acts up to the next one, which is not known any more."""
    setup = synthetic_problem("kbm", {}, known=True)
    heldout, simulator = setup.data.heldout, setup.simulator
    controls = heldout.measurements.controls.clone()
    controls[:, -6:] += 1.0
    other = heldout._replace(measurements=heldout.measurements._replace(controls=controls))
    theta = simulator.parameters.start()
    first, second = (
        infer_controls(simulator, theta, drop_last_samples(each, 5), heldout.guess)
        for each in (heldout, other)
    )
    assert torch.equal(first.simulated.states, second.simulated.states)


def test_tracks_too_short_to_predict_are_refused():
    problem = synthetic_problem("kbm", {}).data.heldout
    with pytest.raises(ValueError, match="`tracks` must have 2000 samples"):
        drop_last_samples(problem, 1000)


def test_models_are_compared_segment_by_segment():
    change = errors(0.2, 0.4).change_from(errors(0.1, 0.1))
    assert change["followed_change"] == pytest.approx(0.2)
    assert change["foreseen_change_std"] == pytest.approx(0.2)
    assert errors(0.2).change_from(errors(0.1))["followed_change_std"] is None
