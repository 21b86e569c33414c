"""The truth that lags behind its commands: its manoeuvres, and what models score against it."""

import pytest
import torch

from diffstack_mmv.dynamics.lagged_truth import (
    VARIANTS,
    CommandProfile,
    LaggedTruth,
    command_profiles,
    score,
)
from diffstack_mmv.vehicles import load_vehicle

PROFILES = command_profiles()
PROMPT = LaggedTruth(acceleration_lag_s=0.002, curvature_lag_s=0.002, drag=0.0, friction=9.0)
SHORT = CommandProfile(3.0, PROFILES["left turn"].command[15:30])


@pytest.mark.parametrize(
    ("name", "fastest", "quarters"),
    [
        ("S-curve", 7.4, 0.0),
        ("left turn", 16.3, 1.0),
        ("right turn", 16.3, -1.0),
        ("left U-turn", 15.0, 2.0),
        ("right U-turn", 15.0, -2.0),
    ],
)
def test_a_profile_turns_as_far_as_its_name_says(
    name: str, fastest: float, quarters: float
) -> None:
    speed, command = PROFILES[name]
    found = LaggedTruth()(command, speed, 0.1)
    way = torch.cat([found.position[:1], found.position.diff(dim=0)])
    turned = torch.atan2(way[-1, 1], way[-1, 0]) * 2 / torch.pi
    assert found.intended_speed[-1].item() == pytest.approx(fastest, abs=0.05)
    assert (turned.item() - quarters + 2) % 4 - 2 == pytest.approx(0.0, abs=0.05)


def test_an_s_curve_goes_to_the_left_before_it_comes_back() -> None:
    found = LaggedTruth()(PROFILES["S-curve"].command, 3.0, 0.1)
    left = found.realised[:, 1] > 1e-3
    right = found.realised[:, 1] < -1e-3
    assert left.nonzero().max() < right.nonzero().min()


@pytest.mark.parametrize("start", [0.0, 0.4, 2.0])
def test_a_truth_that_brakes_stops_and_rolls_no_way_back(start: float) -> None:
    brake = torch.tensor([-2.0, 0.1]).double().expand(20, 2)
    found = LaggedTruth()(brake, start, 0.1)
    assert found.speed[-1] == 0
    assert found.intended_speed[-1] == 0
    assert torch.equal(found.position[-1], found.position[-3])
    assert (found.position[:, 0].diff() >= 0).all()


@pytest.mark.parametrize("letters", ["AE", "BD", "BC"])
def test_without_any_lag_it_does_not_matter_which_signals_are_handed_over(letters: str) -> None:
    first, second = (score(load_vehicle("bicycle"), SHORT, VARIANTS[x], PROMPT) for x in letters)
    assert tuple(first) == pytest.approx(tuple(second), abs=1e-9)


@pytest.mark.parametrize("letter", ["B", "C"])
def test_who_is_told_the_realised_wheel_speeds_follows_more_nearly(letter: str) -> None:
    told, commanded = (
        score(load_vehicle("bicycle"), SHORT, VARIANTS[x]).gm3_m for x in (letter, "D")
    )
    assert told < 0.2 * commanded
