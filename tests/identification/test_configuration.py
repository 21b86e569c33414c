"""What configs/identify.yaml describes."""

import pytest
from hydra.utils import instantiate

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
