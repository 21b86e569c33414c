"""Command lines that cannot be: every script, run in this process, with all else that it needs."""

from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import mkdtemp

from benchmarks.faults.trial import Result, Trial, each
from benchmarks.faults.workplace import base, done, said

WITHOUT_A_BASE = ("dashboard", "download_imptc")
"""Commands that need a network to work."""
COMMON = ("nonsense=1", "out", "seed={")
WRONG: dict[str, tuple[str, ...]] = {
    "convert": (
        "data=horse", "data.root=nowhere", "data=trajdata", "dt_s=0", "dt_s=-1", "dt_s=nan", "workers=0",
        "workers=x", "smoother=horse", "+smoother.window_s=-1", "+smoother.order=9", "max_gap_s=0",
        "min_duration_s=-1", "data.recordings.limits.span_s=0", "+data.recordings.limits.speed_mps.horse=3",
        "data.recordings._target_=os.system", "+data.recordings.horse=1", "data=two_wheeler +data.recordings.horse=1",
        "data=csv data.units.time=h", "data=csv data.columns.time=t", "data=csv data.name=a-b", "data=csv data.mode=horse",
        "data=csv data.types.bike=horse", "data=csv +data.given.day=exam", "data=csv data.rate_hz=0",
        "data=eth_ucy data.held_out=paris", "data=citr", "data=dut", "data=sdd", "data=autobike",
        "data=sdd data.recordings.min_certainty=x", "strict=7.5", "data.cache=/dev/null",
    ),
    "train": (
        "dynamics=car", "vehicle=hovercraft", "vehicle=none.yaml", "modes=[bike]", "modes=[]", "horizon_s=0.95",
        "horizon_s=-3", "history_s=0", "data.cache=nowhere", "cost.weights.final_goal=-1", "solver.max_iterations=0",
        "predictor=horse", "goal=horse", "loss=horse", "trainer=horse", "optim.optimizer._target_=os.system",
        "callbacks.checkpoint._target_=builtins.exec", "+extra._target_=subprocess.run", "batch_size=0",
        "seed=-1", "dt_s=0", "start=none.ckpt", "vehicle.mass_kg=-1", "vehicle.name=[1]", "vehicle.wheels=[]", "epochs=-2",
        "epochs=x", "data.stride=0", "data.neighbors=-1", "data.radius_m=-1", "data.sequences=[horse]",
        "trainer.accelerator=horse", "validation.share=2.5", "optim.optimizer.lr=-1", "augmentation@data.module.augmentation=horse",
        "++stack.optimizer._target_=shutil.rmtree", "++planner.scores=[{_target_:os.system}]",
    ),
    "evaluate": (
        "checkpoint=null", "checkpoint=none.ckpt", "checkpoint=README.md", "checkpoint=.", "goal=horse", "split=7",
        "split=exam", "solver=horse", "device=9", "device=horse", "horizon_s=x", "horizon_s=2.0", "dt_s=0.2", "modes=[horse]",
        "modes=[motorcycle]", "batch_size=0", "situations=[horse]", "data.cache=nowhere", "baselines=horse", "history_s=-1",
    ),
    "compare": ("runs=[]", "runs=[nowhere]", "runs=7", "runs=[.]", "score=horse", "score=[plan_ade]", "wandb=horse"),
    "identify": (
        "dynamics=horse", "data.cache=nowhere", "vehicle=none.yaml", "vehicle=skateboard", "choice=horse", "mode=horse", "dt_s=0",
        "thresholds.identifiable=-1", "starts=-1", "tracks=0", "tracks=-1", "heldout=-1", "parameters=[grip]", "profile=[grip]",
        "splits=[exam]", "splits=[]", "folds=-1", "folds=1", "foresee_s=-1", "noise.along_m=-1", "noise={along_m: 0, across_m: 0}",
        "controls=measured", "controls={steer: 0.1}", "controls=horse", "stretch.min_s=90",
        "stretch.min_s=5.0", "tracking.segment_steps=0", "tracking.jerk_mps3=-1", "others.kbm._target_=os.system",
        
    ),
    "navigate": (
        "scenario=horse", "controller=horse", "vehicle=horse", "dynamics=car", "cases=0", "cases=-3", "chunk=0", "scenario.humans=-1",
        "scenario.humans=50", "dt_s=0", "dt_s=0.26", "limit_s=-1", "limit_s=0", "verdict=horse", "phase=horse",
        "limits.speed_max_mps=0", "people=predictor", "people=predictor people_checkpoint=none.ckpt",
        "controller._target_=os.system", "believed.mass_factor=0", "actual.friction=-1", "actual.mass_factor=nan",
        "robot.noise=[1]", "robot.noise=[-1,0,0,0]", "robot.delay_s=-1", "robot.step_s=0", "against=[nowhere]", "against=[.]",
        "first_case=-5", "search.samples=0", "animate=-1", "show=[9]", "crowd=horse", "footprint=horse", "published=horse",
        "scenario.circle_radius_m=0", "scenario.pedestrian_radius_m=-1", "limits.acceleration_min_mps2=3", "seed=-1",
        "controller=diffmpc controller.planner.starts=-1", "baselines.orca._target_=os.system",
    ),
    "simulate": (
        "vehicle=horse", "vehicle=none.yaml", "dynamics=horse", "controls=none.csv", "manoeuvre=horse", "dt_s=0", "dt_s=-0.1",
        "speed_mps=x", "speed_mps=nan", "controls=README.md", "controls=.", "manoeuvre.curvature=x", "others.kbm._target_=os.system",
        "manoeuvre._target_=builtins.eval", "vehicle.limits.steer_max_rad=-1",
    ),
    "report": (
        "runs=[]", "runs=[nowhere]", "runs=[.]", "runs=7", "runs=[README.md]", "episodes=-1", "episodes=x", "page=/dev/null/x",
        "nowhere", "page=.",
    ),
    "results": (
        "size=horse", "launcher=horse", "size.seeds=[]", "size.goals=[horse]", "models={car: x}",
        "sets.sample.modes={horse: bicycle}", "sets.sample.modes={bicycle: horse}", "sets.sample.data=horse",
        "raw=nowhere sets={thab: {data: thab_vru, root: nowhere, modes: {bicycle: bicycle}}}", "resamples=0", "size.epochs=-1",
        "overrides=7", "launcher.processes=0", "launcher._target_=os.system",
    ),
    "dashboard": ("modes=[bike]", "entity=null", "modes=7", "entity=e modes=[horse]"),
    "generate_sample": ("seed=x", "seed=-1", "seed=1.5"),
    "download_imptc": ("parts=horse", "parts=[]"),
}  # fmt: skip


@cache
def works(script: str) -> bool:
    """Whether a command works without a fault: else another fault than that would be told."""
    if script not in WITHOUT_A_BASE:
        done(script, [*base(script), f"out={Path(mkdtemp()) / 'out'}"])
    return True


def ran(script: str, arguments: list[str], folder: Path) -> Result:
    """Run a command with a fault; without it works, so that what it tells is about the fault."""
    works(script)
    told = said(script, [*base(script), f"out={folder / 'out'}", *arguments])
    if told is None:
        return Result.SILENT
    raise ValueError(told)


def words(line: str) -> list[str]:
    """Arguments of a line; mappings hold blanks."""
    parts: list[str] = []
    for word in line.split():
        if parts and parts[-1].count("{") > parts[-1].count("}"):
            parts[-1] += " " + word
        else:
            parts.append(word)
    return parts


def trials() -> Iterator[Trial]:
    """All wrong command lines."""
    for script, lines in WRONG.items():
        faults = ((line, partial(ran, script, words(line))) for line in (*lines, *COMMON))
        yield from each(f"configuration of {script}", faults)
