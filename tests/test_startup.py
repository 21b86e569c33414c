"""What a command imports before it has read its configuration: nothing that takes seconds."""

import ast
import json
import os
import string
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from dmmv_conventions.cache import FORMAT_VERSION, STATE_FILE

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = sorted(path.stem for path in (ROOT / "scripts").glob("*.py") if path.stem != "__init__")
LIGHT = {
    "dmmv_conventions",
    "diffstack_mmv.commands.cli",
    "diffstack_mmv.commands.command_line",
    "diffstack_mmv.commands.config_checks",
    "diffstack_mmv.commands.data_checks",
    "diffstack_mmv.device_checks",
    "diffstack_mmv.commands.drive_checks",
    "diffstack_mmv.commands.evaluation_checks",
    "diffstack_mmv.commands.experiment_jobs",
    "diffstack_mmv.commands.jobs",
    "diffstack_mmv.commands.records",
    "diffstack_mmv.commands.run_checks",
    "diffstack_mmv.commands.table_jobs",
    "diffstack_mmv.commands.training_checks",
    "hydra.utils",
    "omegaconf",
    "tqdm",
    *sys.stdlib_module_names,
}
HEAVY = ("torch", "pandas", "scipy", "matplotlib", "trajdata", "wandb", "pytorch_lightning")
OF_THE_WORK = ("matplotlib", "trajdata", "wandb", "pytorch_lightning", "torch._dynamo")
"""What no part needs to judge its values."""
# imports what every command imports first, and goes on with each command in a fork of its own
SERVE = """
import atexit, json, os, runpy, sys
import diffstack_mmv.commands.cli
for line in sys.stdin:
    heavy, file, *sys.argv = json.loads(line)
    if child := os.fork():
        os.waitpid(child, 0)
        print(flush=True)
        continue
    told = os.open(file, os.O_CREAT | os.O_WRONLY)
    os.dup2(told, 1), os.dup2(told, 2)
    atexit.register(lambda: print("HEAVY", *[name for name in heavy if name in sys.modules]))
    runpy.run_path(sys.argv[0], run_name="__main__")
    sys.exit()
"""
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


def run(code):
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=ENVIRONMENT)


@pytest.fixture(scope="module")
def ask(tmp_path_factory):
    """Run a command in a process of its own; its output, and what it imported of some modules."""
    process = subprocess.Popen(
        [sys.executable, "-c", SERVE], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        text=True, cwd=ROOT, env=ENVIRONMENT,
    )  # fmt: skip
    file = tmp_path_factory.mktemp("told") / "output"

    def run_command(script, heavy, *arguments):
        file.unlink(missing_ok=True)
        asked = heavy, str(file), str(ROOT / "scripts" / f"{script}.py"), *arguments
        print(json.dumps(asked), file=process.stdin, flush=True)
        assert process.stdout.readline() == "\n"
        told, _, imported = file.read_text().rpartition("HEAVY")
        return told, imported.split()

    with process:
        yield run_command


@pytest.mark.parametrize("script", SCRIPTS)
def test_scripts_import_nothing_heavy_at_first(script):
    body = ast.parse((ROOT / "scripts" / f"{script}.py").read_text()).body
    names = [node.module for node in body if isinstance(node, ast.ImportFrom)]
    names += [alias.name for node in body if isinstance(node, ast.Import) for alias in node.names]
    assert [name for name in names if not {name, name.split(".")[0]} & LIGHT] == []


@pytest.mark.parametrize(
    ("script", "arguments", "told"),
    [
        ("train", ["--help"], "python scripts/train.py"),
        ("evaluate", ["--cfg", "job"], "checkpoint: null"),
        ("train", ["data.cache=nowhere", "dynamics=gm3"], "hold a finished conversion"),
        ("train", ["data.cache=nowhere", "epochs=many"], "`epochs` must be a number"),
        ("navigate", ["people=predictor"], "`people_checkpoint` must be given"),
    ],
)
def test_answers_without_work_import_nothing_heavy(script, arguments, told, ask, tmp_path):
    out = [] if "--help" in arguments else [f"out={tmp_path}"]
    answer, imported = ask(script, HEAVY, *arguments, *out)
    assert told in answer
    assert imported == []


@pytest.fixture(scope="module")
def converted(tmp_path_factory):
    """As much of a conversion as is read before the work begins."""
    cache = tmp_path_factory.mktemp("cache")
    scenes = [{"name": "one", "split": "train", "agents": {"bicycle": 1}}]
    state = {"format_version": FORMAT_VERSION, "complete": True, "scenes": scenes}
    (cache / "thab_vru").mkdir()
    (cache / "thab_vru" / STATE_FILE).write_text(json.dumps(state))
    return cache


JUDGED_WITH_TORCH = [
    ("evaluate", ["device=none"], "`device` must be auto, cpu, or a device"),
]
JUDGED_WITHOUT_TORCH = [
    ("train", ["validation.every_epochs=0"], "`validation.every_epochs` must be at least 1"),
    ("train", ["trainer.accelerator=car"], "`trainer.accelerator` must be one of auto, cpu"),
    ("train", ["loss.control=-1"], "`loss.control` must be at least 0"),
    ("train", ["data.module.loading.workers=-1"], "`workers` must be at least 0"),
    ("train", ["data.module.augmentation.probability=2"], "`probability` must lie in"),
    ("train", ["physics.rate=0"], "`physics.rate` must be positive"),
    ("train", ["cost.weights.final_goal=-1"], "`weights.final_goal` must be positive"),
    ("train", ["vehicle.mass_kg=0"], "`mass_kg` must be positive, but got 0"),
    ("evaluate", ["baselines.simple.ctra.predictor.dt_s=-1"], "`dt_s` must be positive"),
    ("evaluate", ["situations=[flying]"], "`situations` must be one of moving"),
    ("evaluate", ["split=some"], "`split` must be one of train, but got 'some'"),
    ("identify", ["foresee_s=-1"], "`prediction_s` must be at least 0"),
    ("identify", ["folds=1"], "`folds` must be 0 or at least 2"),
    ("identify", ["noise.along_m=-1"], "`along_m` must be positive"),
    ("identify", ["splits=[train,tset]"], "`splits` must be one of train, but got 'tset'"),
    ("identify", ["dynamics.dt_s=-1"], "`dt_s` must be positive"),
    ("navigate", ["search.samples=0"], "`samples` must be at least 1"),
    ("navigate", ["vehicle.wheelbase.initial=9"], "`initial` must lie between low"),
    ("simulate", ["others.kbm.dt_s=-1"], "`dt_s` must be positive"),
    ("simulate", ["vehicle.limits.steer_max_rad=2"], "`limits.steer_max_rad` must lie in"),
    ("results", ["launcher.processes=0"], "`processes` must be at least 1"),
    ("closed_loop_table", ["launcher.processes=0"], "`processes` must be at least 1"),
]


@pytest.mark.parametrize(
    ("script", "arguments", "told", "absent"),
    [(*row, OF_THE_WORK) for row in JUDGED_WITH_TORCH]
    + [(*row, HEAVY) for row in JUDGED_WITHOUT_TORCH],
)
def test_values_are_judged_before_the_work_is_imported(
    script, arguments, told, absent, converted, ask, tmp_path
):
    given = [f"out={tmp_path}"]
    if script in ("train", "evaluate", "identify"):
        given.append(f"data.cache={converted}")
    if script == "evaluate":
        given += ["checkpoint=pretrained", "split=train"]
    answer, imported = ask(script, absent, *given, *arguments)
    assert told in answer
    assert imported == []


@pytest.mark.parametrize("name", sorted(path.stem for path in (ROOT / "configs").glob("*.yaml")))
def test_help_can_be_shown_and_has_an_example(name):
    content = yaml.safe_load((ROOT / "configs" / f"{name}.yaml").read_text(encoding="utf-8"))
    template = content.get("hydra", {}).get("help", {}).get("template", "")
    assert string.Template(template.replace("${hydra", "")).is_valid()
    assert name == "command" or f"python scripts/{name}.py" in template


def test_the_solver_is_imported_without_the_compiler_of_torch():
    code = "import sys, diffstack_mmv.control; print('torch._dynamo' in sys.modules)"
    assert run(code).stdout.strip() == "False"


def test_a_reader_that_has_seen_enough_shows_no_traceback():
    """As `--help | head -1` does."""
    reading, writing = os.pipe()
    os.close(reading)
    told = subprocess.run(
        [sys.executable, ROOT / "scripts" / "train.py", "--help"],
        stdout=writing, stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    os.close(writing)
    assert told.returncode == 1
    assert told.stderr == ""
