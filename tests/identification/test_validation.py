"""Errors on stretches that were held out."""

import pytest
import torch

from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.identification import (
    Division,
    HeldOut,
    Identifier,
    Stretch,
    Study,
    TrackingSettings,
    folds,
    held_out,
)
from diffstack_mmv.identification.validation import cut_short
from tests.identification.conftest import synthetic_case


def stretch(recording, start=0, steps=30, curvature=0.0):
    """A stretch at 5 m/s along a circle."""
    course = 5.0 * curvature * 0.1 * torch.arange(steps + 1)
    heading = torch.stack([course[:-1].cos(), course[:-1].sin()], -1)
    position = torch.cat([torch.zeros(1, 2), 0.5 * heading.cumsum(0)])
    return Stretch(f"{recording}@{start}s", position, course, torch.full((steps + 1,), 5.0))


def errors(*values):
    column = torch.tensor(values)
    return HeldOut(tuple("abcd"[: len(values)]), column, torch.ones(len(values)), 2 * column)


@pytest.mark.parametrize("count", [2, 3, 9])
def test_each_stretch_is_held_out_once_and_recordings_stay_together(count):
    every = [stretch(name, start) for name in "abcde" for start in (0, 5)]
    parts = folds(Division(every[:6], every[6:]), count, seed=0)
    assert sorted(each.name for part in parts for each in part.heldout) == sorted(
        each.name for each in every
    )
    for part in parts:
        fitted, heldout = ({each.recording for each in group} for group in part)
        assert not fitted & heldout
        assert fitted


def test_a_single_recording_makes_no_folds():
    with pytest.raises(ValueError, match="`recordings` must be at least 2"):
        folds(Division([stretch("a")], [stretch("a", 5)]), 2, seed=0)


def test_a_straight_ride_is_foreseen_and_a_turn_that_begins_is_not(bicycle):
    straight, turning = stretch("a"), stretch("b")
    bend = stretch("c", steps=10, curvature=0.15).position
    position = torch.cat([straight.position[:21], straight.position[20] + bend[1:]])
    turning = turning._replace(position=position)
    study = Study(
        bicycle, Division([straight], [straight, turning]), TrackingSettings(), Identifier()
    )
    found = study(lambda: model_of(bicycle, "unicycle", 0.1)).heldout
    assert float(found.foreseen[0]) < 1e-3
    assert float(found.foreseen[1]) > 0.3
    assert float(found.followed[1]) < 0.1


def test_what_is_foreseen_is_not_looked_at():
    case = synthetic_case("kbm", {}, known=False)
    problem = case.data.heldout
    moved = problem.targets.position.clone()
    moved[:, -5:] += 7.0
    other = problem._replace(targets=problem.targets._replace(position=moved))
    found = Identifier()(case.tracker, case.data)
    near, far = (
        held_out(case._replace(data=case.data._replace(heldout=each)), found, Identifier(), 5)
        for each in (problem, other)
    )
    assert float(far.foreseen) == pytest.approx(7 * 2**0.5, abs=float(near.foreseen))
    assert float(near.foreseen) < 2.0


def test_tracks_too_short_to_foresee_are_refused():
    problem = synthetic_case("kbm", {}).data.heldout
    with pytest.raises(ValueError, match="`tracks` must have 2000 samples"):
        cut_short(problem, 1000)


def test_models_are_compared_stretch_by_stretch():
    change = errors(0.2, 0.4).change_from(errors(0.1, 0.1))
    assert change["followed_change"] == pytest.approx(0.2)
    assert change["foreseen_change_std"] == pytest.approx(0.2)
    assert errors(0.2).change_from(errors(0.1))["followed_change_std"] is None


def test_folds_hold_out_every_stretch_of_a_study(bicycle):
    division = Division([stretch("a"), stretch("b")], [stretch("c")])
    parts = folds(division, 3, seed=0)
    study = Study(bicycle, division, TrackingSettings(), Identifier(), 10, parts)
    assert study(lambda: model_of(bicycle, "unicycle", 0.1)).heldout.names == (
        "a@0s",
        "b@0s",
        "c@0s",
    )
