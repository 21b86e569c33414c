"""Drive one vehicle open loop, beside other models under the same commands."""

import logging
from pathlib import Path
from typing import Any

from diffstack_mmv.commands.cli import DictConfig, OmegaConf, command, instantiate
from diffstack_mmv.commands.config_checks import require_file
from diffstack_mmv.commands.run_checks import require_same_run
from dmmv_conventions.checks import require_positive
from dmmv_conventions.configs import config_folder

logger = logging.getLogger(__name__)


def check(config: DictConfig) -> None:
    """Refuse recorded controls that are not there, and parts that cannot be built."""
    if config.controls:
        require_file("controls", config.controls, "Give controls=FILE.csv.")
    require_positive("dt_s", config.dt_s)
    others = (each for each in config.others.values() if each)
    driven = config.recorded if config.controls else config.manoeuvre
    for part in (config.spec, driven, config.dynamics, *others):
        instantiate(part)


def admit(config: DictConfig) -> None:
    """Refuse a folder with a drive of other settings: a page would show the models of both."""
    content: Any = OmegaConf.to_container(config)
    require_same_run(Path(config.out), "simulate", content)


@command(config_folder(), "simulate", check, admit)
def main(config: DictConfig) -> None:
    """Run the models, write trajectories and figures."""
    from diffstack_mmv.dynamics.open_loop import drive, save_run, wheel_history
    from diffstack_mmv.plotting import draw_runs, draw_wheels, save_figure

    spec = instantiate(config.spec)
    manoeuvre = instantiate(config.recorded if config.controls else config.manoeuvre)
    wheelbase_m = spec.wheelbase.entries()[0][0]
    inputs = manoeuvre(wheelbase_m, config.dt_s)
    chosen = {config.names.dynamics: config.dynamics}
    others = {name: each for name, each in config.others.items() if each and name not in chosen}
    names = [wheel.name for wheel in spec.wheels]
    runs, out = {}, Path(config.out)
    for name, each in (chosen | others).items():
        model = instantiate(each).double()
        runs[name] = drive(model, inputs, manoeuvre.speed_mps)
        save_run(out / f"trajectory_{name}.csv", model, runs[name])
        history = wheel_history(model, runs[name])
        if history is not None:
            save_figure(draw_wheels(history, names, config.dt_s), out / f"wheels_{name}.png")
    lean = runs[config.names.dynamics].lean
    leaning = lean.numpy() if spec.leans and lean is not None else None
    motions = {name: run.motion for name, run in runs.items()}
    save_figure(draw_runs(motions, config.dt_s, leaning), out / "runs.png")
    logger.info("Trajectories and figures: %s; as a page: dmmv-report %s", out, out)


if __name__ == "__main__":
    main()
