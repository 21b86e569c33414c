"""Episodes of one folder are those of one policy and of one conversion of the recordings."""

import json

from omegaconf import DictConfig, OmegaConf

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
