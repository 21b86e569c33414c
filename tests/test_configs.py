"""Every configuration file composes, and what it describes can be built."""

from importlib.util import find_spec
from pathlib import Path

import pytest
import torch
import yaml
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import OmegaConf

import diffstack_mmv.commands.cli  # noqa: F401  registers the resolvers
from diffstack_mmv.commands.experiment_jobs import Experiment
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.stack import DiffStackMMV
from dmmv_conventions.arguments import require_arguments
from dmmv_conventions.foretold import require_foretold
from dmmv_conventions.targets import nodes

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
COMMANDS = sorted(path.stem for path in CONFIGS.glob("*.yaml") if path.stem != "command")
# groups of train.yaml whose options can be exchanged one by one
GROUPS = (
    "dynamics",
    "predictor",
    "cost",
    "solver",
    "planner",
    "goal",
    "loss",
    "optim",
    "physics",
    "stack",
    "callbacks",
    "logger",
)
OPTIONS = [
    (group, path.stem) for group in GROUPS for path in sorted((CONFIGS / group).glob("*.yaml"))
]


def composed(name, *overrides):
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        known = ["data.cache=CACHE"] if "- data:" in (CONFIGS / f"{name}.yaml").read_text() else []
        known += ["data=dut", "data.cache=CACHE"] if any("=replay" in e for e in overrides) else []
        config = compose(name, [*known, *overrides], return_hydra_config=True)
        HydraConfig.instance().set_config(config)
        OmegaConf.set_struct(config, False)
        config.pop("hydra")
    # every interpolation leads somewhere; put in its place, it would be copied again and again
    OmegaConf.to_container(config, resolve=True)
    return config


@pytest.mark.parametrize(
    "name", [name for name in COMMANDS if "- data:" in (CONFIGS / f"{name}.yaml").read_text()]
)
def test_commands_on_data_compose(name):
    assert composed(name).data.name == "thab_vru"


@pytest.mark.parametrize(("group", "option"), OPTIONS, ids=lambda value: value)
def test_every_option_of_training_builds_a_stack(group, option, tmp_path):
    config = composed("train", f"{group}={option}", f"out={tmp_path}")
    stack = instantiate(config.stack)
    assert isinstance(stack, DiffStackMMV)
    assert isinstance(stack.planner.dynamics, DynamicsModel)


@pytest.mark.parametrize(
    "vehicle", sorted(path.stem for path in (CONFIGS / "vehicle").glob("*.yaml"))
)
@pytest.mark.parametrize("dynamics", ["unicycle", "kbm"])
def test_every_vehicle_works_with_every_dynamics(vehicle, dynamics):
    config = composed(
        "train", f"vehicle={vehicle}", f"dynamics={dynamics}", "predictor=constant_velocity"
    )
    assert isinstance(instantiate(config.stack.dynamics), DynamicsModel)


# converted.yaml is no data set, but the part that all of them share
@pytest.mark.parametrize(
    "data", sorted({path.stem for path in (CONFIGS / "data").glob("*.yaml")} - {"converted"})
)
def test_every_data_set_builds_its_module(data):
    config = composed("train", f"data={data}", "data.root=RECORDINGS")
    assert type(instantiate(config.data.module)).__name__ == "TrajdataModule"


def test_predictor_and_planner_share_one_dynamics_model():
    stack = instantiate(composed("train", "dynamics=kbm").stack)
    names = [name for name, _ in stack.named_parameters() if "wheelbase" in name]
    assert len(names) == 1


@pytest.mark.parametrize(
    "experiment", sorted(path.stem for path in (CONFIGS / "experiment").glob("*.yaml"))
)
def test_experiments_only_override(experiment):
    """Each is for training, or for the tables of many trainings."""
    content = yaml.safe_load((CONFIGS / "experiment" / f"{experiment}.yaml").read_text())
    if "sets" in content:
        assert set(composed("results", f"experiment={experiment}", "raw=recordings").sets)
    else:
        assert composed("train", f"experiment={experiment}").epochs > 0


@pytest.mark.parametrize("given", [[], ["predictor=constant_velocity"], ["predictor=trajectron"]])
def test_the_quickstart_takes_any_predictor_and_has_a_small_one(given):
    chosen = given or ["predictor=trajectron_small"]
    config = composed("train", "experiment=quickstart", *given)
    assert config.predictor == composed("train", *chosen).predictor


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "experiment", [[], *([f"experiment={name}"] for name in ("eth_ucy", "shared_space"))]
)
def test_no_job_of_the_tables_is_refused_by_its_own_command(experiment, tmp_path):
    """By what a command judges before it builds anything; one run of each set."""
    config = composed("results", *experiment, "size=full", f"raw={tmp_path}", f"out={tmp_path}")
    experiment = Experiment(config, tmp_path, Path("scripts"))
    runs = list({run.data: run for run in experiment.runs()}.values())
    jobs = [experiment.conversion(name) for name in {run.data for run in runs}]
    jobs += experiment.pretrainings(runs)
    jobs += [experiment.training(run) for run in runs]
    commands = {job.name: job.commands for job in jobs}
    assert len(commands) > len(runs) > 2
    for script, *arguments in (line[1:] for lines in commands.values() for line in lines):
        content = OmegaConf.to_container(composed(Path(script).stem, *arguments), resolve=True)
        require_arguments(content)
        require_foretold(content)


def test_horizon_that_is_no_multiple_of_the_step_is_refused():
    config = composed("train", "horizon_s=2.95")
    with pytest.raises(InstantiationException, match=r"`horizon_s` must be a multiple of 0\.1"):
        instantiate(config.stack)


# command, group with exchangeable options, the node of the configuration that uses it
USED = [
    ("convert", "data", "data.recordings"),
    ("convert", "smoother", "smoother"),
    ("evaluate", "baselines", "baselines"),
    ("evaluate", "goal", "goal"),
    ("evaluate", "solver", "solver"),
    ("identify", "choice", "study"),
    ("identify", "dynamics", "dynamics"),
    ("identify", "mode", "study"),
    ("navigate", "controller", "controller"),
    ("navigate", "cost", "controller"),
    ("navigate", "crowd", "world"),
    ("navigate", "dynamics", "controller"),
    ("navigate", "footprint", "world"),
    ("navigate", "people", "controller"),
    ("navigate", "scenario", "scenario"),
    ("navigate", "sensing", "world"),
    ("closed_loop_table", "launcher", "launcher"),
    ("closed_loop_table", "table", "launcher"),
    ("results", "launcher", "launcher"),
    ("results", "size", "launcher"),
    ("simulate", "dynamics", "dynamics"),
    ("simulate", "manoeuvre", "manoeuvre"),
    ("train", "augmentation", "data.module"),
    ("train", "balance", "data.module"),
    ("train", "trainer", "trainer"),
]
# options that need something a test does not have, and what they then say
SLURM = ("closed_loop_table", "results") if find_spec("submitit") is None else ()
NEEDS = {
    **{(command, "launcher", "slurm"): "`submitit` must be installed" for command in SLURM},
    ("navigate", "controller", "ppo"): "`policy` must be given",
    ("navigate", "people", "predictor"): "`checkpoint` must be given for the predictor",
    ("train", "trainer", "gpu"): "gpu backend|CUDA",
}
PLACES = {
    "augmentation": "augmentation@data.module.augmentation",
    "balance": "+balance@data.module.balance",
}
CHOICES = [
    (command, group, path.stem, node)
    for command, group, node in USED
    for path in sorted((CONFIGS / group).glob("*.yaml"))
    if path.stem not in ("converted", "trajdata") or command != "convert"
]


@pytest.mark.parametrize(("command", "group", "option", "node"), CHOICES)
def test_every_option_of_every_command_can_be_built(command, group, option, node, tmp_path):
    chosen = f"{PLACES.get(group, group)}={option}"
    folders = ["data.root=RECORDINGS"] if command in ("convert", "train", "identify") else []
    config = composed(command, chosen, f"out={tmp_path}", *folders)
    described = OmegaConf.select(config, node)
    problem = NEEDS.get((command, group, option))
    if problem is None or (option == "gpu" and torch.cuda.is_available()):
        assert instantiate(described) is not None
    else:
        with pytest.raises(Exception, match=problem):
            instantiate(described)


def refused(judge, node):
    """The message with which settings are refused, none where they are not."""
    try:
        judge(node)
    except InstantiationException as error:
        return str(error.__cause__)
    except ValueError as error:
        return str(error)
    return None


@pytest.mark.parametrize("name", ["train", "navigate", "identify", "tune"])
def test_what_is_refused_ahead_is_what_the_parts_refuse(name, tmp_path, unchecked):
    """Every number of every part is made -1: parts say the same of it as their sources do."""
    content = OmegaConf.to_container(composed(name, f"out={tmp_path}"), resolve=True)
    require_foretold(content)
    changed = [
        {**node, key: -1}
        for _, node in nodes(content)
        if isinstance(node, dict) and "_target_" in node and not node.get("_partial_")
        for key, value in node.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    ]
    told = {told: node for node in changed if (told := refused(require_foretold, node))}
    assert len(told) >= 10
    assert {message: refused(instantiate, node) for message, node in told.items()} == {
        message: message for message in told
    }
