"""Episodes of one folder are those of one policy and of one conversion of the recordings."""

import json

import pytest
from omegaconf import DictConfig, OmegaConf

from diffstack_mmv.commands.drive_checks import require_trained_for
from diffstack_mmv.types import Mode
from scripts import navigate
from tests.data.conftest import ToyAgent, write_cache


def drive(**changes) -> DictConfig:
    """What tells apart what a drive reads from files."""
    return OmegaConf.create({"people_checkpoint": None, "policy": None, "scenario": {}} | changes)


def test_a_policy_trained_anew_at_its_place_is_another_one(tmp_path):
    policy, found = tmp_path / "policy.zip", []
    for content in (b"one", b"two", b"one"):
        policy.write_bytes(content)
        found.append(navigate._contents(drive(policy=str(policy))))
    assert found[0] != found[1]
    assert found[0] == found[2]


def test_recordings_converted_anew_at_their_place_are_other_ones(tmp_path):
    write_cache(tmp_path, {"scene": ("test", [ToyAgent("a", Mode.PEDESTRIAN, rows=30)])})
    source = {"_target_": "diffstack_mmv.data.ConvertedCache", "name": "toy"}
    recordings = {
        "_target_": "diffstack_mmv.data.RecordedScenes",
        "source": source | {"folder": str(tmp_path)},
    }
    config = drive(scenario={"recordings": recordings})
    before = navigate._contents(config)
    assert navigate._contents(config) == before
    state = tmp_path / "toy" / "cache.json"
    other = json.loads(state.read_text()) | {"smoother": {"name": "none", "lookahead_s": 0.0}}
    state.write_text(json.dumps(other))
    assert navigate._contents(config) != before


LIMITS = {"speed_max_mps": 3.0}


def driving(whose, vehicle="bicycle", dynamics="kbm", dt_s=0.25, mass_kg=90.0, limit_s=10.0):
    """What of a configuration gives the numbers of a policy their meaning."""
    body = {"name": vehicle, "mass_kg": mass_kg}
    return {whose: {"vehicle": body, "name": dynamics, "limits": LIMITS}, "dt_s": dt_s} | {
        "view": {"limit_s": limit_s},
        "controller": {"view": {"limit_s": limit_s}},
        "training": {"seconds": 1.0},
    }


def with_policy(folder, **changes) -> DictConfig:
    """A drive by the policy in a folder."""
    chosen = {"policy": str(folder / "policy.zip"), "names": {"dynamics": "kbm"}}
    return OmegaConf.create(driving("believed", **changes) | chosen | {"vehicle": {"name": "v"}})


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"vehicle": "scooter", "mass_kg": 80.0}, "`vehicle` must be .*, 'bicycle', but got 'scoo"),
        ({"dynamics": "gm3"}, "`dynamics` must be that of the policy's training, 'kbm', but got"),
        ({"dt_s": 0.5}, "`dt_s` must be that of the policy's training, 0.25, but got 0.5"),
        ({"mass_kg": 80.0}, "`vehicle.mass_kg` must be .*, 90.0, but got 80.0"),
        ({"limit_s": 25.0}, "`controller.view.limit_s` must be .*, 10.0, but got 25.0"),
    ],
)
def test_a_policy_drives_what_it_was_trained_with(changes, told, tmp_path):
    trained = OmegaConf.create(driving("actual"))
    (tmp_path / "config.yaml").write_text(OmegaConf.to_yaml(trained))
    require_trained_for(with_policy(tmp_path))
    with pytest.raises(ValueError, match=told):
        require_trained_for(with_policy(tmp_path, **changes))


@pytest.mark.parametrize("content", [None, "cases: 1\n"])
def test_a_policy_that_tells_nothing_of_its_training_drives_with_a_warning(
    content, caplog, tmp_path
):
    if content is not None:
        (tmp_path / "config.yaml").write_text(content)
    require_trained_for(with_policy(tmp_path))
    assert "tells what it was trained with: it drives v (kbm) all the same" in caplog.text


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("limits.speed_max_mps=[1]", "`limits.speed_max_mps` must be a number, but got [1]. Give"),
        ("vehicle.limits.speed_max_mps=[1]", "`limits.speed_max_mps` must be a number, but got"),
        ("scenario.humans=[1]", "`scenario.humans` must be a whole number, but got [1] in the"),
        ("model.dt_s=[1]", "`model.dt_s` must be a number, but got [1] in the configuration."),
        ("++limits.speed_max_mps=fast", "cruise_mps` must be a value, but got an interpolation"),
    ],
)
def test_what_no_drive_can_compute_with_is_told_by_its_key(setting, told, refusal, tmp_path):
    assert told in refusal("navigate", setting, f"out={tmp_path}")
