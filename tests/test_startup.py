"""What a command imports before it has read its configuration: nothing that takes seconds."""

import ast
import os
import string
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = sorted(path.stem for path in (ROOT / "scripts").glob("*.py") if path.stem != "__init__")
LIGHT = {
    "dmmv_conventions",
    "diffstack_mmv.cli",
    "diffstack_mmv.config_checks",
    "diffstack_mmv.jobs",
    "hydra.utils",
    "omegaconf",
    "tqdm",
    *sys.stdlib_module_names,
}
HEAVY = ("torch", "pandas", "scipy", "matplotlib", "trajdata", "wandb", "pytorch_lightning")
TELL = """
import atexit, runpy, sys
atexit.register(lambda: print("HEAVY", *[name for name in {heavy} if name in sys.modules]))
sys.argv = {arguments}
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def run(code):
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)


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
def test_answers_without_work_import_nothing_heavy(script, arguments, told, tmp_path):
    out = [] if "--help" in arguments else [f"out={tmp_path}"]
    argv = [str(ROOT / "scripts" / f"{script}.py"), *arguments, *out]
    done = run(TELL.format(heavy=HEAVY, arguments=argv))
    assert told in done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].split() == ["HEAVY"]


@pytest.mark.parametrize("name", sorted(path.stem for path in (ROOT / "configs").glob("*.yaml")))
def test_help_can_be_shown(name):
    content = yaml.safe_load((ROOT / "configs" / f"{name}.yaml").read_text(encoding="utf-8"))
    template = content.get("hydra", {}).get("help", {}).get("template", "")
    assert string.Template(template.replace("${hydra", "")).is_valid()


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
