"""Errors on segments that were held out."""

import pytest
import torch

from diffstack_mmv.identification import Identifier, ValidationErrors, validation_errors
from diffstack_mmv.identification.inference.validation import (
    concatenate_errors,
    drop_last_samples,
)
from diffstack_mmv.identification.shooting.tracking import infer_controls
from tests.identification.conftest import synthetic_problem


def errors(*values):
    column = torch.tensor(values)
    return ValidationErrors(
        tuple("abcd"[: len(values)]), column, torch.ones(len(values)), 2 * column
    )


@pytest.fixture(scope="module")
def identified():
    setup = synthetic_problem("kbm", {}, known=False)
    return setup, Identifier()(setup.simulator, setup.data)


def test_what_is_predicted_is_not_used(identified):
    setup, found = identified
    heldout = setup.data.heldout
    moved = heldout.measurements.position.clone()
    moved[:, -5:] += 7.0
    other = heldout._replace(measurements=heldout.measurements._replace(position=moved))
    near, far = (
        validation_errors(
            setup._replace(data=setup.data._replace(heldout=each)), found, Identifier(), 5
        ).prediction
        for each in (heldout, other)
    )
    assert float(far) == pytest.approx(7 * 2**0.5, abs=float(near))
    assert float(near) < 2.0


def test_what_is_followed_is_the_root_mean_square_of_all_samples(identified):
    setup, found = identified
    heldout = setup.data.heldout
    moved = heldout.measurements.position + torch.tensor([3.0, 4.0])
    other = heldout._replace(measurements=heldout.measurements._replace(position=moved))
    near, far = (
        validation_errors(
            setup._replace(data=setup.data._replace(heldout=each)), found, Identifier(), 5
        )
        for each in (heldout, other)
    )
    assert float(near.tracking) < 0.3
    assert float(far.tracking) == pytest.approx(5.0, abs=float(near.tracking))
    assert torch.equal(far.samples, heldout.measurements.weight.sum(-1))


def test_the_end_of_each_track_is_dropped_whatever_its_length():
    problem = synthetic_problem("kbm", {}).data.heldout
    weight, controls = torch.ones(2, 30), torch.ones(2, 30, 2)
    weight[1, 20:] = 0.0
    measurements = problem.measurements._replace(weight=weight, control_weight=controls)
    early = drop_last_samples(problem._replace(measurements=measurements), 5).measurements
    assert [row.nonzero().flatten().tolist() for row in early.weight] == [
        list(range(25)),
        list(range(15)),
    ]
    assert early.control_weight.sum((1, 2)).tolist() == [2 * 24, 2 * 14]


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


def test_pooled_errors_weigh_what_is_followed_by_samples():
    """What is foreseen is a fixed number of samples of each segment."""
    record = ValidationErrors(
        ("a", "b"), torch.tensor([1.0, 3.0]), torch.tensor([10.0, 30.0]), torch.tensor([1.0, 2.0])
    )
    told = record.pooled()
    assert told["followed"] == pytest.approx(((10 * 1 + 30 * 9) / 40) ** 0.5)
    assert told["foreseen"] == pytest.approx(2.5**0.5)


def test_errors_of_several_parts_are_in_the_order_of_their_names():
    parts = [
        ValidationErrors(names, *(torch.tensor(values) + shift for shift in (0.0, 10.0, 20.0)))
        for names, values in ((("c", "a"), [3.0, 1.0]), (("b",), [2.0]))
    ]
    joined = concatenate_errors(parts)
    assert joined.names == ("a", "b", "c")
    assert [column.tolist() for column in joined[1:]] == [
        [1.0, 2.0, 3.0],
        [11.0, 12.0, 13.0],
        [21.0, 22.0, 23.0],
    ]
