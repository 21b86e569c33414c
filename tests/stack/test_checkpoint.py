"""Checkpoints: read without running code that stands in them, refused where they are broken."""

import pickle

import pytest
import torch

from diffstack_mmv.planning import PredictedGoal
from diffstack_mmv.prediction import Ensemble
from diffstack_mmv.prediction.trajectron.agent_batch import PEDESTRIAN
from diffstack_mmv.stack import (
    learned_from,
    load_ensemble,
    load_predictor,
    load_stack,
    load_weights,
    read_checkpoint,
    write_lean,
)
from dmmv_conventions.pretrained import FOLDER, checkpoint_path
from tests.stack.test_module import stack_of


class Runs:
    """Unpickling it would write a file."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return eval, (f"open({str(self.mark)!r}, 'w').close()",)


def saved(path, **content):
    whole = {"provenance": {"config": {"stack": {}}}, "state_dict": {}}
    torch.save(whole | content, path)
    return path


def building(path, node):
    return saved(path, provenance={"config": {"stack": node}})


@pytest.mark.parametrize("hidden", [False, True])
def test_a_checkpoint_builds_nothing_but_ours(tmp_path, hidden):
    mark = tmp_path / "mark"
    write = {
        "_target_": "pathlib.Path.write_text",
        "_args_": [{"_target_": "pathlib.Path", "_args_": [str(mark)]}, "code ran"],
    }
    within = {"_target_": "diffstack_mmv.stack.assemble", "planner": [write]}
    with pytest.raises(ValueError, match=r"built, but got 'pathlib.Path.write_text' at .*a.ckpt"):
        load_stack(building(tmp_path / "a.ckpt", within if hidden else write))
    assert not mark.exists()


@pytest.mark.parametrize(
    ("node", "told"),
    [
        (
            {"_target_": "diffstack_mmv.vehicles.load_vehicle", "_args_": ["bicycle"]},
            "`checkpoint` must describe a stack, but got VehicleSpec",
        ),
        (
            {"_target_": "diffstack_mmv.stack.assemble", "horse": 1},
            "`checkpoint` must describe a stack that this version",
        ),
    ],
    ids=["another thing", "of another version"],
)
def test_what_is_built_has_to_be_a_stack(tmp_path, node, told):
    with pytest.raises(ValueError, match=told):
        load_stack(building(tmp_path / "a.ckpt", node))


def test_a_package_that_is_not_there_is_told(tmp_path, monkeypatch):
    monkeypatch.setenv("DMMV_TRUSTED_PACKAGES", "mine_of_old")
    told = r"No module named 'mine_of_old'.* A package of your own has to be installed, or its"
    with pytest.raises(ValueError, match=told):
        load_stack(building(tmp_path / "a.ckpt", {"_target_": "mine_of_old.Model"}))


def in_a_plain_file(content, path):
    path.write_bytes(pickle.dumps(content))


def in_an_archive_of_torch(content, path):
    torch.save({"state_dict": content}, path)


@pytest.mark.parametrize(
    ("write", "found"),
    [(in_a_plain_file, "no checkpoint"), (in_an_archive_of_torch, r"[\w.]*eval in it")],
)
def test_a_pickle_runs_nothing(tmp_path, write, found):
    mark, path = tmp_path / "mark", tmp_path / "a.ckpt"
    write(Runs(mark), path)
    with pytest.raises(ValueError, match=f"must be readable.*, but got {found}"):
        read_checkpoint(path)
    assert not mark.exists()


def test_what_is_none_is_told_without_the_advice_of_torch(tmp_path):
    (tmp_path / "a.ckpt").write_bytes(pickle.dumps({"a": (1, 2)})[:-3] + b"x..")
    with pytest.raises(ValueError, match="must be readable, but got no checkpoint in"):
        read_checkpoint(tmp_path / "a.ckpt")


@pytest.mark.parametrize(
    "content",
    [
        {"provenance": None},
        {"provenance": {"config": None}},
        {"provenance": {"config": {"stack": None}}},
        {"state_dict": None},
        {"state_dict": {"a": 1}},
    ],
)
def test_a_checkpoint_without_its_parts_is_refused(content, tmp_path):
    with pytest.raises(ValueError, match="`checkpoint` must hold its configuration and weights"):
        read_checkpoint(saved(tmp_path / "a.ckpt", **content))


def test_a_cut_or_damaged_checkpoint_is_refused(tmp_path):
    whole = saved(tmp_path / "a.ckpt", state_dict={"a": torch.zeros(50)}).read_bytes()
    for end in range(0, len(whole), 97):
        (tmp_path / "cut.ckpt").write_bytes(whole[:end])
        with pytest.raises(ValueError, match="`checkpoint` must be readable"):
            read_checkpoint(tmp_path / "cut.ckpt")


def test_a_changed_bit_is_no_other_weight(tmp_path):
    whole = saved(tmp_path / "a.ckpt", state_dict={"a": torch.zeros(500)}).read_bytes()
    place = whole.index(bytes(1500)) + 700
    changed = whole[:place] + b"\x3f" + whole[place + 1 :]
    (tmp_path / "a.ckpt").write_bytes(changed)
    with pytest.raises(ValueError, match="must be readable, but got a wrong checksum"):
        read_checkpoint(tmp_path / "a.ckpt")


def test_weights_that_are_lost_are_refused(tmp_path):
    built = stack_of(PredictedGoal())
    weights = {name: torch.full_like(each, torch.nan) for name, each in built.state_dict().items()}
    path = saved(tmp_path / "a.ckpt", state_dict=weights)
    with pytest.raises(ValueError, match="`checkpoint` must hold no NaN"):
        load_weights(built, path)


@pytest.mark.parametrize("name", ["unicycle", "kbm", "gm3"])
def test_a_shipped_checkpoint_is_small_lean_and_loads(name):
    path = checkpoint_path(f"pretrained/{name}")
    assert path.stat().st_size < 5e6
    content = read_checkpoint(path)
    assert set(content) == {"state_dict", "provenance"}
    assert "/" not in str(content["provenance"]["config"]["names"])
    stack, config = load_stack(path)
    assert config["names"]["dynamics"] == name
    assert not stack.training


def test_a_stack_is_loaded_by_the_name_of_a_shipped_one_or_a_path_as_text():
    named, path = load_stack("pretrained"), str(checkpoint_path("pretrained"))
    assert named.config == load_stack(path).config


def test_the_default_of_the_shipped_is_diffkbm_and_others_are_told(tmp_path, monkeypatch):
    assert checkpoint_path("pretrained") == FOLDER / "kbm.ckpt"
    assert checkpoint_path("runs/last.ckpt").name == "last.ckpt"
    with pytest.raises(ValueError, match="`checkpoint` must be one of gm3, kbm, unicycle"):
        checkpoint_path("pretrained/tank")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pretrained").mkdir()
    assert str(checkpoint_path("pretrained")) == "pretrained"


def test_a_lean_checkpoint_keeps_weights_and_what_it_is_built_from(tmp_path):
    whole = read_checkpoint(checkpoint_path("pretrained"))
    config = whole["provenance"]["config"] | {"out": "somewhere", "data": {"cache": "there"}}
    state = {"provenance": whole["provenance"] | {"config": config}, "optimizer_states": [1]}
    torch.save(whole | state, tmp_path / "whole.ckpt")
    write_lean(tmp_path / "whole.ckpt", tmp_path / "lean.ckpt")
    lean = read_checkpoint(tmp_path / "lean.ckpt")
    assert lean["provenance"]["config"] == whole["provenance"]["config"]
    assert "optimizer_states" not in lean


@pytest.mark.parametrize(
    ("told", "known"),
    [({"a": ["1", "2"]}, {"a": ["1", "2"]}), ({"a": 3}, {}), (["a"], {}), (None, {})],
)
def test_a_checkpoint_tells_what_it_learned_from_or_nothing(tmp_path, told, known):
    whole = read_checkpoint(checkpoint_path("pretrained"))
    assert learned_from("pretrained") == {}
    torch.save(whole | {"provenance": whole["provenance"] | {"data": told}}, tmp_path / "a.ckpt")
    assert learned_from(tmp_path / "a.ckpt") == known
    write_lean(tmp_path / "a.ckpt", tmp_path / "lean.ckpt")
    assert learned_from(tmp_path / "lean.ckpt") == known


@pytest.mark.parametrize("beside", [True, False])
def test_who_never_saw_a_pedestrian_beside_an_ego_is_told(beside, tmp_path, caplog):
    content = read_checkpoint(checkpoint_path("pretrained"))
    weights = {
        name: each if beside or f".branches.{PEDESTRIAN}." not in name else torch.zeros_like(each)
        for name, each in content["state_dict"].items()
    }
    torch.save(content | {"state_dict": weights}, tmp_path / "a.ckpt")
    load_predictor(tmp_path / "a.ckpt")
    assert ("has seen no pedestrian" in caplog.text) is not beside


def test_an_ensemble_plans_as_its_first_member_and_predicts_as_all():
    stack, config = load_ensemble(["pretrained/gm3", "pretrained/kbm"])
    assert config["names"]["dynamics"] == "gm3"
    assert isinstance(stack.predictor, Ensemble)
    assert len(stack.predictor.members) == 2
    assert not stack.predictor.training
    assert not isinstance(load_ensemble(["pretrained/kbm"]).stack.predictor, Ensemble)
