"""What configs/identify.yaml describes."""

from types import SimpleNamespace

import pytest
import torch
from hydra.utils import instantiate

import diffstack_mmv.data
from data_converters import CausalSmoother, Unsmoothed
from diffstack_mmv.data import motion_through
from diffstack_mmv.identification import IdentificationStudy
from scripts import identify
from tests.test_configs import CONFIGS, composed

OPTIONS = [
    f"{group}={path.stem}"
    for group in ("mode", "choice")
    for path in sorted((CONFIGS / group).glob("*.yaml"))
]


def study(*overrides):
    return instantiate(composed("identify", *overrides).study)


@pytest.mark.parametrize("option", OPTIONS)
def test_every_option_builds_a_study(option):
    assert isinstance(study(option), IdentificationStudy)


@pytest.mark.parametrize(
    ("override", "name", "expected"),
    [
        ("noise.along_m=0.05", "along_m", 0.05),
        ("tracking.jerk_mps3=2.0", "jerk_mps3", 2.0),
        ("tracking.segment_steps=null", "segment_steps", None),
        ("+tracking.start_speed_mps=2.0", "start_speed_mps", 2.0),
        (
            "controls={acceleration: 0.1, steer: 0.01}",
            "controls",
            {"acceleration": 0.1, "steer": 0.01},
        ),
    ],
)
def test_assumptions_are_those_of_the_command_line(override, name, expected):
    assert getattr(study(override).assumptions, name) == expected


def test_numbers_of_the_command_line_reach_the_study():
    options = ("tracks=6", "heldout=2", "folds=3", "starts=1", "parameters=[friction]", "seed=4")
    built = study(*options, "stretch.max_s=4.0", "foresee_s=0.5", "thresholds.informed=0.9")
    assert (built.tracks, built.heldout, built.folds, built.seed) == (6, 2, 3, 4)
    assert (built.identifier.starts, built.identifier.thresholds.informed) == (1, 0.9)
    assert (built.segments.max_s, built.prediction_s) == (4.0, 0.5)
    assert built.parameters == ["friction"]


def test_finished_parts_of_measured_rides_are_of_the_same_code(monkeypatch):
    def key():
        config = composed("identify", "controls=measured", "out=runs")
        return identify.measured_study(config).parts.key

    before = key()
    assert before == key()
    monkeypatch.setattr(identify, "code_version", lambda: "another")
    assert before != key()


def test_samples_as_they_are_move_with_the_velocities_of_smoothed_ones(monkeypatch):
    """Differences of samples cut rides at low speeds that were noise, and began fits so far off
    that the rider's rates were anything.
    """
    time_s, dt_s = 0.04 * torch.arange(200, dtype=torch.float64), 0.04
    path = torch.stack([10 * (0.3 * time_s).sin(), -10 * (0.3 * time_s).cos()], -1)
    noise = torch.randn(path.shape, generator=torch.Generator().manual_seed(0)).double()
    noisy = motion_through(path + 0.05 * noise, torch.zeros_like(time_s), dt_s)
    monkeypatch.setattr(diffstack_mmv.data, "read_tracks", lambda *_: {"a": noisy}, raising=False)

    def read_behind(smoother):
        source = SimpleNamespace(smoother_settings=smoother.settings)
        return identify.read_motions((source, (), "bicycle"), dt_s)["a"]

    found = read_behind(Unsmoothed())
    assert torch.equal(found.position, noisy.position)
    assert noisy.velocity.norm(dim=-1).min() < 1.0
    torch.testing.assert_close(
        found.velocity.norm(dim=-1), torch.full_like(time_s, 3.0), atol=0.4, rtol=0
    )
    assert read_behind(CausalSmoother()) is noisy
