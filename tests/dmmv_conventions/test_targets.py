"""What a file may have built: nothing outside this project and a short list."""

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from diffstack_mmv.vehicles import config_folder
from dmmv_conventions.targets import (
    NOTHING,
    OF_A_RUN,
    OF_A_STACK,
    TRUSTED_VARIABLE,
    require_buildable,
)

HOSTILE = (
    "os.system",
    "pathlib.Path.write_text",
    "builtins.exec",
    "subprocess.run",
    "hydra.utils.instantiate",
    "hydra.utils.call",
    "hydra.utils.get_method",
    "importlib.import_module",
    "torch.load",
    "functools.partial",
    "pytorch_lightning.cli.LightningCLI",
    # through names of this project
    "diffstack_mmv.commands.cli.sys.exit",
    "diffstack_mmv.stack.checkpoint.instantiate",
    "diffstack_mmv.stack.checkpoint.torch.load",
    "diffstack_mmv.dynamics.catalogue.load_dynamics",
    "diffstack_mmv.vehicles.catalogue.os.replace",
    "diffstack_mmv.vehicles.save_vehicle",
    "diffstack_mmv.stack.DiffStackMMV.load_from_checkpoint",
    "diffstack_mmv.stack.DiffStackMMV.__class__",
    "diffstack_mmv.data.registration.TrajdataWindows",
    "diffstack_mmv.data.scene_table.SceneTable",
    "dmmv_conventions.opening.CachedUnifiedDataset",
    "data_converters.conversion.shutil.rmtree",
    "data_converters.imptc.download.download_imptc",
    "data_converters.conversion",
    "data_converters.convert",
    "diffstack_mmv.nowhere.Nothing",
    "diffstack_mmv..costs",
    "",
    None,
    7,
)


@pytest.mark.parametrize("allowed", [OF_A_STACK, OF_A_RUN], ids=["checkpoint", "run"])
@pytest.mark.parametrize("target", HOSTILE)
def test_what_is_not_ours_is_refused_by_name(target, allowed):
    with pytest.raises(ValueError, match="`_target_` must name what a file may have built") as told:
        require_buildable({"_target_": target}, allowed, "in a.ckpt")
    assert repr(target) in str(told.value)


@pytest.mark.parametrize(
    "content",
    [
        {"a": {"b": [{"c": {"_target_": "os.system"}}]}},
        {"_target_": "diffstack_mmv.dynamics.DiffKBM", "_args_": [{"_target_": "os.system"}]},
        {"_target_": "os.system", "_partial_": True},
        {"_target_": "hydra.utils.get_method", "path": "os.system"},
        {"_target_": "hydra.utils.get_method", "path": "diffstack_mmv.dynamics.DiffKBM", "x": 1},
        {"a": "${oc.create:{_target_: os.system}}"},
        {"a": [("${oc.env:HOME}",)]},
    ],
)
def test_nothing_hides_below_the_top(content):
    with pytest.raises(ValueError, match="in a.ckpt"):
        require_buildable(content, OF_A_RUN, "in a.ckpt")


@pytest.mark.parametrize(
    "target", ["diffstack_mmv.dynamics.DiffKBM", "torch.optim.AdamW", "mine.Model"]
)
def test_a_plain_file_builds_nothing_at_all(monkeypatch, target):
    monkeypatch.setenv(TRUSTED_VARIABLE, "mine")
    with pytest.raises(ValueError, match="_target_"):
        require_buildable({"_target_": target}, NOTHING, "in mine.yaml")


def test_a_package_of_ones_own_is_allowed_by_name(monkeypatch):
    content = {"_target_": "mine.models.Model"}
    with pytest.raises(ValueError, match=f"{TRUSTED_VARIABLE}=NAME"):
        require_buildable(content, OF_A_STACK, "in a.ckpt")
    monkeypatch.setenv(TRUSTED_VARIABLE, "others, mine")
    require_buildable(content, OF_A_STACK, "in a.ckpt")


FILES = sorted(
    f"{path.parent.relative_to(config_folder()).as_posix()}/{path.stem}"
    for path in config_folder().rglob("*.yaml")
    if path.parent != config_folder() and path.parent.name != "calibrated"
)


@pytest.mark.parametrize("file", FILES)
def test_every_file_of_the_groups_holds_allowed_names_only(file):
    content = OmegaConf.load(config_folder() / f"{file}.yaml")
    for node in _mappings(OmegaConf.to_container(content)):
        if isinstance(node.get("_target_"), str) and "${" not in node["_target_"]:
            name = node["_target_"]
            named = {"_target_": node["path"] if name == "hydra.utils.get_method" else name}
            require_buildable(named, OF_A_RUN, f"in {file}")


def _mappings(content):
    if isinstance(content, dict):
        yield content
    for part in content.values() if isinstance(content, dict) else content:
        if isinstance(part, dict | list):
            yield from _mappings(part)


OF_THE_STACK = ("goal", "loss", "optim", "physics", "planner", "predictor", "stack")
OPTIONS = [
    (group, path.stem)
    for group in OF_THE_STACK
    for path in sorted((config_folder() / group).glob("*.yaml"))
]


@pytest.mark.parametrize(("group", "option"), OPTIONS)
def test_the_stack_of_a_run_can_be_read_back(group, option, tmp_path):
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        overrides = [f"{group}={option}", f"data.cache={tmp_path}", "out=out"]
        config = compose("train", overrides, return_hydra_config=True)
    names = {"dynamics": "kbm", "predictor": "any"}
    stack = OmegaConf.to_container(OmegaConf.merge(config, {"names": names}).stack, resolve=True)
    require_buildable(stack, OF_A_STACK, "in last.ckpt")
