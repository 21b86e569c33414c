"""Groups of roll-outs: every window is in one class of each kind, or in none."""

import pytest
import torch

from diffstack_mmv.identification.measured import RideWindows
from diffstack_mmv.identification.measured.rollout_report import (
    LATERAL,
    SPEEDS,
    rollout_groups,
)


def windows_of(speed, yaw_rate, names=("a_1", "a_2", "b_1"), recording=(0, 1, 2)):
    """Windows of two steps, each of one speed and yaw rate."""
    count = len(recording)
    speed = torch.tensor(speed).double().unsqueeze(-1).expand(count, 3)
    rate = torch.tensor(yaw_rate).double().unsqueeze(-1).expand(count, 2)
    zero = torch.zeros(count, 3).double()
    return RideWindows(
        torch.tensor(recording), names, zero[:, :2], torch.zeros(count, 3, 2).double(), zero,
        torch.ones(count, 3, dtype=torch.bool), zero[:, 1:], zero[:, 1:], speed, rate, zero,
    )  # fmt: skip


def test_sessions_are_grouped_by_the_names_of_their_recordings():
    groups = rollout_groups(windows_of([3.0] * 3, [0.0] * 3))
    assert groups["session a"].tolist() == [True, True, False]
    assert groups["session b"].tolist() == [False, False, True]
    assert groups["all"].all()


def test_a_session_or_class_of_all_windows_does_not_repeat_them():
    groups = rollout_groups(windows_of([3.0] * 3, [0.5] * 3, recording=(0, 0, 0)))
    assert "session a" not in groups
    assert [name for name, chosen in groups.items() if chosen.all()] == ["all"]


@pytest.mark.parametrize(("kind", "edges"), [("speed", SPEEDS), ("lateral", LATERAL)])
def test_a_window_is_in_one_class_of_each_kind(kind, edges):
    groups = rollout_groups(windows_of([0.5, 3.0, 8.0], [-2.0, 0.1, 0.4]))
    classes = [chosen for name, chosen in groups.items() if name.startswith(f"{kind} ")]
    assert len(classes) == len(edges) - 1
    assert torch.stack(classes).sum(0).tolist() == [1, 1, 1]


def test_a_window_without_yaw_rate_is_in_no_class_of_lateral_acceleration():
    groups = rollout_groups(windows_of([3.0] * 3, [0.1, torch.nan, 0.1]))
    lateral = [chosen for name, chosen in groups.items() if name.startswith("lateral")]
    assert torch.stack(lateral).sum(0).tolist() == [1, 0, 1]
