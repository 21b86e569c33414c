"""Command lines that cannot be: every script, run in this process."""

import contextlib
import io
import sys
from collections.abc import Callable, Iterator
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from tempfile import mkdtemp

from hydra.core.global_hydra import GlobalHydra

from benchmarks.faults.tables import THAB, text, thab_rows
from benchmarks.faults.trial import Result, Trial, each
from data_converters import ConversionSettings, ThabVruDataset, convert

NEEDING = ("convert", "train", "evaluate", "identify", "compare")
UNFINISHED = ("", "data.cache=nowhere", "runs=[]")
COMMON = ("nonsense=1", "out", "seed={")
WRONG: dict[str, tuple[str, ...]] = {
    "convert": (
        "data=horse", "data.root=nowhere", "data=trajdata data.root=x", "dt_s=0 data.root=x",
        "dt_s=-1 data.root=x", "workers=0 data.root=x", "smoother=horse", "smoother.window_s=-1 data.root=x",
        "smoother.order=9 data.root=x", "data.recordings.limits.span_s=0 data.root=x",
        "+data.recordings.limits.speed_mps.horse=3 data.root=x", "data.recordings._target_=os.system data.root=x",
        "data=two_wheeler data.root=x data.recordings.horse=1",
    ),
    "train": (
        "dynamics=car", "vehicle=hovercraft", "vehicle=none.yaml", "modes=[bike]", "horizon_s=2.95", "horizon_s=-3",
        "data.cache=nowhere", "cost.weights.final_goal=-1", "solver.max_iterations=0", "predictor=horse",
        "goal=horse", "loss=horse", "trainer=horse", "optim.optimizer._target_=os.system",
        "callbacks.checkpoint._target_=builtins.exec", "+extra._target_=subprocess.run", "batch_size=0",
        "seed=-1", "dt_s=0", "start=none.ckpt", "vehicle.mass_kg=-1",
    ),
    "evaluate": (
        "", "checkpoint=none.ckpt", "checkpoint=README.md", "checkpoint=.", "goal=horse checkpoint=x", "split=7 checkpoint=y", "solver=horse",
    ),
    "compare": ("runs=[]", "runs=[nowhere]", "runs=7", "runs=[.]"),
    "identify": ("",
        "dynamics=horse", "data.cache=nowhere", "vehicle=none.yaml", "choice=horse", "mode=horse", "dt_s=0", "thresholds.identifiable=-1", "starts=-1",
    ),
    "navigate": (
        "scenario=horse", "controller=horse", "vehicle=horse", "dynamics=car", "cases=0", "chunk=0", "scenario.humans=-1",
        "scenario.humans=50", "dt_s=0", "dt_s=0.26", "limit_s=-1", "verdict=horse", "phase=horse", "limits.speed_max_mps=0",
        "people=predictor", "people=predictor people_checkpoint=none.ckpt", "controller._target_=os.system",
        "believed.mass_factor=0", "actual.friction=-1", "robot.noise=[1]", "robot.delay_s=-1", "against=[nowhere] cases=0",
        "first_case=-5",
    ),
    "simulate": (
        "vehicle=horse", "vehicle=none.yaml", "dynamics=horse", "controls=none.csv", "manoeuvre=horse", "dt_s=0",
        "speed_mps=x", "controls=README.md", "controls=.",
    ),
    "generate_sample": ("seed=x", "seed=-1"),
    "download_imptc": ("parts=horse", "parts=[]"),
}  # fmt: skip


@cache
def small_cache() -> Path:
    """A cache with tracks too short for a window: what finds no other fault ends there."""
    folder = Path(mkdtemp())
    for number in range(12):
        path = folder / "raw" / "cyclists" / "moving" / f"{number}.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text(THAB, thab_rows(2.0 * number)))
    convert(ConversionSettings(ThabVruDataset(folder / "raw"), folder / "cache", progress=False))
    return folder / "cache"


def ran(script: str, arguments: str, folder: Path) -> Result:
    """Run a command that cannot work; it has to say something else than without the fault."""
    told = _said(script, arguments, folder)
    if told is None:
        return Result.SILENT
    # what a command says without its data is no answer to another fault
    if script in NEEDING and arguments not in UNFINISHED and told == _said(script, "", folder):
        return Result.SILENT
    raise ValueError(told)


def _said(script: str, arguments: str, folder: Path) -> str | None:
    """What a command tells before it ends with a failure, None where it works."""
    main: Callable[[], None] = import_module(f"scripts.{script}").main
    needs = script in NEEDING and script != "compare"
    place = folder / "cache" if script == "convert" else small_cache()
    data = [f"data.cache={place}"] if needs and "data.cache" not in arguments else []
    told, before = io.StringIO(), sys.argv
    GlobalHydra.instance().clear()
    try:
        sys.argv = [script, *data, f"out={folder / 'out'}", *arguments.split()]
        with contextlib.redirect_stderr(told), contextlib.redirect_stdout(io.StringIO()):
            main()
    except SystemExit as ended:
        if "Traceback" in told.getvalue():
            raise AssertionError(told.getvalue()) from ended
        failed = ended.code not in (0, None)
        return "\n".join(told.getvalue().strip().splitlines()[1:]) if failed else None
    finally:
        sys.argv = before
        GlobalHydra.instance().clear()
    return None


def trials() -> Iterator[Trial]:
    """All wrong command lines."""
    for script, lines in WRONG.items():
        faults = ((line or "nothing", partial(ran, script, line)) for line in (*lines, *COMMON))
        yield from each(f"configuration of {script}", faults)
