"""Evaluate a checkpoint per mode, beside its trivial baselines."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from diffstack_mmv.commands.cli import DictConfig, OmegaConf, command, instantiate
from diffstack_mmv.commands.data_checks import (
    new_modes,
    other_history,
    other_modes,
    require_same_horizon,
    told_of_data,
)
from diffstack_mmv.commands.evaluation_checks import require_evaluation
from diffstack_mmv.commands.records import log_record
from diffstack_mmv.device_checks import usable_device
from dmmv_conventions.configs import config_folder
from dmmv_conventions.pretrained import checkpoint_path
from dmmv_conventions.versions import code_version, file_hash

if TYPE_CHECKING:
    from diffstack_mmv.data import TrajdataModule, WindowDataset
    from diffstack_mmv.metrics import Calibration
    from diffstack_mmv.stack import DiffStackMMV, Evaluation, Windows

logger = logging.getLogger(__name__)


def check(config: DictConfig) -> None:
    """Refuse an evaluation without checkpoint or recordings."""
    require_evaluation(config)
    # for their mistakes alone, before the checkpoint is read and the windows are looked for
    usable_device(config.device)
    replaced = (config.get("goal"), config.get("solver"))
    for part in (*told_of_data(config.data.module), config.baselines, *replaced):
        instantiate(part)


def _calibration(
    config: DictConfig, stack: DiffStackMMV, module: TrajdataModule
) -> Calibration | None:
    """Levels of the regions, fitted to the split that the configuration names."""
    from diffstack_mmv.stack import fitted_calibration

    split = config.calibration.split
    if split is None:
        return None
    module.prepare_splits([split])
    _admit_split("calibration.split", config, module.dataset(split))
    return fitted_calibration(stack, module.dataset(split), config.batch_size)


def _admit_split(argument: str, config: DictConfig, windows: WindowDataset) -> int:
    """Refuse recordings of the training in a split, unless it is that of the training itself.

    Returns:
        How many there are.
    """
    from diffstack_mmv.data import other_releases, require_unseen, seen_recordings
    from diffstack_mmv.stack import learned_from

    split = OmegaConf.select(config, argument)
    lineages = [learned_from(path) for path in _checkpoints(config)]
    seen = sorted({s for each in lineages for s in seen_recordings(windows.samples, each)})
    for name in sorted({r for each in lineages for r in other_releases(windows.samples, each)}):
        logger.warning(
            "The checkpoint learned from %s, which was cut from recordings that '%s' may hold too. "
            "A conversion of imptc_vru with data.other_release=FOLDER leaves out those of another "
            "split.", name, split,
        )  # fmt: skip
    if split != "train" and not config.allow_seen:
        require_unseen(argument, split, seen)
    return len(seen)


def _take_windows(config: DictConfig, trained: dict[str, Any]) -> None:
    """Take the modes of the training where none are given; refuse or tell other windows."""
    require_same_horizon(config, trained)
    told = other_history(config, trained)
    if told:
        logger.warning(told)
    if config.modes is None:
        config.modes = config.data.module.windows.ego_modes = trained["modes"]


def admit(config: DictConfig) -> None:
    """Refuse a folder that holds the report of another evaluation."""
    out = Path(config.out)
    if (out / "metrics.json").is_file():
        from diffstack_mmv.reporting import require_same_evaluation

        # what is not given is taken from the training, by the task in its own configuration
        require_same_evaluation(out, _prepared(config.copy()).header)


class Prepared(NamedTuple):
    """What is evaluated, on what."""

    stack: DiffStackMMV
    trained: dict[str, Any]  # configuration of the training
    module: TrajdataModule
    header: dict[str, Any]  # of the report


def _prepared(config: DictConfig) -> Prepared:
    """The stack with the parts that replace those of its training, its data, and the header."""
    from diffstack_mmv.stack import load_ensemble

    stack, trained = load_ensemble(_checkpoints(config), usable_device(config.device))
    _take_windows(config, trained)
    if "goal" in config:
        stack.goal = instantiate(config.goal)
    if "solver" in config:
        stack.planner.solver = instantiate(config.solver)
    module = instantiate(config.data.module)
    return Prepared(stack, trained, module, _header(config, trained, stack, module))


@command(config_folder(), "evaluate", check, admit)
def main(config: DictConfig) -> None:
    """Score every window of a split; write tables and plots.

    Raises:
        ValueError: A part refuses.
    """
    from diffstack_mmv.data import split_windows
    from diffstack_mmv.metrics import EVALUATED, PREDICTED
    from diffstack_mmv.reporting import summarise_modes, write_metrics, write_parquet
    from diffstack_mmv.stack import evaluate_windows

    out, (stack, trained, module, header) = Path(config.out), _prepared(config)
    windows = split_windows(module, config.split)
    header["seen_in_training"] = _admit_split("split", config, windows)
    baselines = dict(instantiate(config.baselines.simple))
    if stack.goal.uses_future:
        baselines |= instantiate(config.baselines.to_goal)
    calibration = _calibration(config, stack, module)
    evaluation = evaluate_windows(
        stack, baselines, windows, config.batch_size, config.plans, calibration,
        config.compile_from, config.seed,
    )  # fmt: skip
    scores = EVALUATED if config.plans else PREDICTED
    vehicle = trained["vehicle"]["name"]
    for mode in header["modes_of_other_vehicles"]:
        logger.warning("Agents of mode '%s' are driven with the vehicle '%s'.", mode, vehicle)
    if told := new_modes(config.modes, trained):
        logger.warning(told)
    metrics = summarise_modes(evaluation.samples, config.situations, vehicle, scores)
    for mode in set(config.modes) - set(metrics["modes"]):
        logger.warning(
            "No sample of mode '%s' in split '%s'; the tables leave it out.", mode, config.split
        )
    header["data_sha256"] = windows.digest()
    write_parquet(out / "samples.parquet", evaluation.samples)
    _remove_drawings(out)
    if config.plots:
        _draw(config, stack, windows, evaluation)
    write_metrics(out, header | metrics, scores)
    log_record(config, scores)
    logger.info("Report: %s; as a page: dmmv-report %s", out / "metrics.md", out)


def _checkpoints(config: DictConfig) -> list[str]:
    """The checkpoint, and those whose predictors are mixed with its own."""
    return [str(path) for path in (config.checkpoint, *config.ensemble)]


def _header(
    config: DictConfig, trained: Mapping[str, Any], stack: DiffStackMMV, module: TrajdataModule
) -> dict[str, Any]:
    """What was evaluated, on what, and by which code."""
    others = _checkpoints(config)[1:]
    return {
        "goal": stack.goal.name,
        "steadiness": getattr(stack.goal, "steadiness", None),  # other goals have none
        "dynamics": trained["names"]["dynamics"],
        "vehicle": trained["vehicle"]["name"],
        "data": config.data.name,
        "split": config.split,
        "seed": trained["seed"],
        "draws_seed": config.seed,
        "smoother": module.source.smoother(),
        "calibrated_on": config.calibration.split,
        "ego_modes": sorted(config.modes),
        "modes_of_other_vehicles": other_modes(config.modes, trained["vehicle"]),
        "plans": config.plans,
        "history_s": config.history_s,
        "stride": config.data.stride,
        "judged_situations": sorted(config.situations),
        "solver": _plain(config.get("solver")),
        "hindsight": stack.loss_weights.hindsight,
        "checkpoint": str(config.checkpoint),
        "checkpoint_sha256": file_hash(checkpoint_path(config.checkpoint)),
        "ensemble": others,
        "ensemble_sha256": [file_hash(checkpoint_path(path)) for path in others],
        "code": code_version(),
    }


def _plain(solver: DictConfig | None) -> Any:
    """The solver that replaces that of the training, as it stands in a report."""
    return None if solver is None else OmegaConf.to_container(solver)


def _draw(
    config: DictConfig, stack: DiffStackMMV, windows: Windows, evaluation: Evaluation
) -> None:
    """Write figures, and what pages draw."""
    from diffstack_mmv.callbacks import scenes_of
    from diffstack_mmv.metrics import DISPLACEMENT
    from diffstack_mmv.plotting import PLANS_FILE, draw_scenes, save_evaluation, save_figure
    from diffstack_mmv.reporting import write_compact
    from diffstack_mmv.reporting.html import HORIZON_FILE, SCENES_FILE, horizon_content
    from diffstack_mmv.stack import outputs_of, representative, scene_records

    out, heading = Path(config.out), DISPLACEMENT.heading
    remark = "" if config.calibration.split is None else "before the correction"
    save_evaluation(out, evaluation.levels, evaluation.errors, config.dt_s, heading, remark)
    curves = horizon_content(evaluation.errors, config.dt_s, heading)
    write_compact(out / HORIZON_FILE, curves)
    if not config.plans:
        return
    records = []
    for mode, chosen in representative(evaluation.samples).items():
        shown = outputs_of(stack, windows, list(chosen.values()))
        scenes = draw_scenes(scenes_of(*shown, list(chosen)))
        save_figure(scenes, out / PLANS_FILE.format(mode=mode))
        records += scene_records(*shown, [f"{mode}, {which} plan ADE" for which in chosen])
    write_compact(out / SCENES_FILE, {"scenes": records})


def _remove_drawings(out: Path) -> None:
    from diffstack_mmv.plotting import remove_evaluation
    from diffstack_mmv.reporting.html import HORIZON_FILE, SCENES_FILE

    remove_evaluation(out)
    for earlier in (HORIZON_FILE, SCENES_FILE):
        (out / earlier).unlink(missing_ok=True)


if __name__ == "__main__":
    main()
