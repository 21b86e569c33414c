"""The command line of the benchmark: it writes what it promises, and refuses with one message."""

import json

import numpy as np
import pytest

from diffstack_mmv.commands.cli import DictConfig
from diffstack_mmv.types import Mode
from scripts.navigate import _controllers
from tests.data.conftest import ToyAgent, write_cache

QUICK = [
    "cases=2", "chunk=1", "controller.planner.starts=0", "animate=0", "~controller@baselines.mppi",
    "~controller@baselines.blind", "~controller@baselines.orca",
]  # fmt: skip


@pytest.fixture
def navigate(command, tmp_path):
    """Run the script in this process; the exit status."""
    return lambda *arguments, out=tmp_path: command("navigate", *arguments, f"out={out}")


def test_it_writes_results_baselines_and_paired_tests_and_resumes(navigate, tmp_path):
    brief = [*QUICK, "limit_s=1.0", "search.samples=64", "controller.planner.steps=8"]
    assert navigate(*brief) == 0
    first = json.loads((tmp_path / "closed_loop.json").read_text())
    assert (first["n"], set(first["baselines"])) == (2, {"straight"})
    assert first["paired"][0]["other"] == "straight"
    assert first["actual_model"]["class"] == first["believed_model"]["class"] == "DiffKBM"
    assert first["footprint"] == first["actual_model"]["footprint"]["shape"] == "disc"
    [stored] = (tmp_path / "episodes" / "diffmpc").glob("test_00000-*.npz")
    with np.load(stored) as arrays:
        assert np.isfinite(arrays["thoughts.plan"][0, 0]).all()
        assert np.isfinite(arrays["thoughts.forecast"][0, 0]).all()
    kept = {file: file.stat().st_mtime_ns for file in (tmp_path / "episodes").rglob("*.npz")}
    assert navigate(*brief, f"against=[{tmp_path}]") == 0
    assert {file: file.stat().st_mtime_ns for file in kept} == kept
    again = json.loads((tmp_path / "closed_loop.json").read_text())
    assert (again["chunk"], again["cases"]) == (1, first["cases"])
    assert again["paired"][1]["success"] == {"only_own": 0, "only_other": 0, "p": None}


DELAYED = ["beside=[own]", "+controller@baselines.own=diffmpc_delay"]
DRIVEN = ["beside=[own]", "+controller@baselines.own=ppo"]


@pytest.mark.parametrize(
    ("name", "value", "given", "warned"),
    [
        ("known_delay_s", "0.2", ["controller=straight"], True),
        ("known_delay_s", "0.2", ["controller=straight", *DELAYED], False),
        ("known_delay_s", "0.2", ["controller.planner.score.margin.horizon_s=${known_delay_s}"],
         False),
        ("people", "wary", ["controller=mppi", "beside=[blind]"], True),
        ("cost", "dmmv", ["controller=mppi"], True),
        ("constraints", "hard", ["controller=dmmv"], True),
        ("constraints", "hard", ["controller=blind", *DELAYED], False),
        ("policy", "nowhere.zip", [], True),
        ("policy", "nowhere.zip", DRIVEN, False),
        ("people_checkpoint", "nowhere.ckpt", [], True),
        ("people_checkpoint", "pretrained", ["people=predictor"], False),
    ],
)  # fmt: skip
def test_a_setting_that_nobody_uses_is_told(command, capfd, tmp_path, name, value, given, warned):
    # what follows the warning is refused, so that nothing is driven
    setting = f"{name}={value}"
    assert command("navigate", *given, setting, "animate=-1", f"out={tmp_path}") == 1
    told = "".join(capfd.readouterr())
    assert "`animate` must be at least 0" in told
    assert (f"{setting} changes nothing" in told) == warned


@pytest.mark.parametrize(("dynamics", "warned"), [("kbm", True), ("gm3", False)])
def test_a_friction_that_no_tyre_feels_is_told(command, capfd, tmp_path, dynamics, warned):
    # what follows the warning is refused, so that nothing is driven
    given = [f"dynamics={dynamics}", "actual.friction=0.3", "animate=-1", f"out={tmp_path}"]
    assert command("navigate", *given) == 1
    told = "".join(capfd.readouterr())
    assert "`animate` must be at least 0" in told
    assert ("actual.friction=0.3 changes nothing: kbm has no tyres" in told) == warned


@pytest.mark.slow
def test_a_run_of_anything_else_is_refused_before_it_replaces_a_file(navigate, refusal, tmp_path):
    given = ["controller=straight", "cases=1", "chunk=1", "beside=[]", "search=null", "animate=0",
             "wandb=none"]  # fmt: skip
    assert navigate(*given) == 0
    kept = [*tmp_path.glob("*.*"), *tmp_path.rglob("*.npz")]
    before = {file: file.read_bytes() for file in kept if file.suffix in (".json", ".yaml", ".npz")}
    for changed, told in (
        ("chunk=2", "the same settings (chunk: 2), but got chunk: 1"),
        ("phase=val", "the same settings (phase: val), but got phase: test"),
        ("controller=blind", "no report of another controller than blind, but got straight"),
    ):
        assert told in refusal("navigate", *given, changed, f"out={tmp_path}")
    assert {file: file.read_bytes() for file in before} == before
    other = [f"against=[{tmp_path}]", "first_case=5", f"out={tmp_path / 'other'}"]
    assert "`against` must share cases with the run" in refusal("navigate", *given, *other)
    assert not (tmp_path / "other" / "episodes").exists()


def test_a_controller_is_no_baseline_of_itself():
    baselines = {"straight": {"speed_mps": 3.0}, "blind": {"speed_mps": 2.0}, "mppi": None}
    own = {"beside": list(baselines), "names": {"controller": "straight"}}
    config = DictConfig({**own, "baselines": baselines, "controller": {"speed_mps": 1.5}})
    assert _controllers(config) == [("blind", {"speed_mps": 2.0}), ("straight", {"speed_mps": 1.5})]


def test_a_massless_controller_is_told_and_drawn_as_what_it_drives_and_not_searched(
    navigate, tmp_path
):
    """It was searched as the vehicle, with the box of the vehicle, and drawn as one."""
    given = ["controller=straight", "footprint=vehicle", "scenario.robot_radius_m=1.5", "cases=3",
             "scenario=square_crossing", "beside=[]", "animate=1", "wandb=none"]  # fmt: skip
    assert navigate(*given) == 0
    found = json.loads((tmp_path / "closed_loop.json").read_text())
    assert "collision" in {case["outcome"] for case in found["cases"]}
    assert "feasible" not in found
    assert found["dynamics"] == found["believed_dynamics"] == "massless"
    assert found["actual_model"]["footprint"] == {"shape": "disc", "radius_m": 0.3}
    told = (tmp_path / "closed_loop.md").read_text()
    assert "The robot is massless (HolonomicRobot, step 0.25 s)" in told
    assert list(tmp_path.rglob("*.png"))


@pytest.mark.slow
def test_a_controller_may_believe_in_dynamics_of_another_name(navigate, tmp_path):
    given = ["dynamics=gm3_paper", "believed.dynamics=kbm_smooth", "footprint=vehicle"]
    assert navigate(*QUICK, "cases=1", *given) == 0
    found = json.loads((tmp_path / "closed_loop.json").read_text())
    assert (found["dynamics"], found["believed_dynamics"]) == ("gm3_paper", "kbm_smooth")
    assert found["actual_model"]["tyre_law"].startswith("PaperBrush")
    assert found["believed_model"]["speed_floor"].startswith("Softplus")
    assert found["footprint"] == "vehicle"
    assert found["actual_model"]["footprint"]["shape"] == "box"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["scenario=moon"], "circle_crossing"),
        (["verdict=kind"], "`verdict` must be"),
        (["limits.acceleration_min_mps2=-0.3"], "stop within the way"),
        (["scenario.clearance_m=0.0", "scenario.robot_radius_m=0.01"], "start without a collision"),
        (["people=predictor"], "checkpoint that scripts/train.py wrote"),
        (["believed.dynamics=magic"], "`dynamics` must be one of gm3, gm3_coordinated, gm3_fine"),
        (["dynamics=unicycle", "actual.dynamics=gm3"], "share its controls with the robot's"),
    ],
)
def test_bad_input_ends_with_one_clear_message(refusal, arguments, message, tmp_path):
    assert message in refusal("navigate", *QUICK, "cases=20", *arguments, f"out={tmp_path}")


@pytest.mark.parametrize(
    "crowd", ["replay", pytest.param("replay_reactive", marks=pytest.mark.slow)]
)
def test_a_recorded_crowd_is_crossed(navigate, tmp_path, crowd):
    walkers = [
        ToyAgent(
            f"walker_{k}", Mode.PEDESTRIAN, 150, first=5 * k, start=(-6.0, 0.4 * k, 0.0), speed=1.1
        )
        for k in range(8)
    ]
    write_cache(tmp_path / "cache", {"one": ("test", walkers)}, "dut")
    data = [
        f"crowd={crowd}",
        "data=dut",
        f"data.cache={tmp_path / 'cache'}",
        "limit_s=10",
        "scenario.blind_mps=0.0",
    ]
    rest = ["cases=1", "search=null", "animate=0", "controller=stop_and_go"]
    gone = ["~controller@baselines.stop_and_go", *QUICK[4:], "~controller@baselines.straight"]
    assert navigate(*data, *rest, *gone) == 0
    found = json.loads((tmp_path / "closed_loop.json").read_text())
    assert (found["n"], found["scenario"], found["crowd"], found["data"]) == (
        1,
        "replay",
        crowd,
        "dut",
    )
    assert found["cases"][0]["acceleration_mps2"] > 0
