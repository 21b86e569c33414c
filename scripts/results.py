"""The paper's table by one command."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diffstack_mmv.commands.cli import DictConfig, command, instantiate
from diffstack_mmv.commands.data_checks import require_modes
from diffstack_mmv.commands.experiment_jobs import BEST, Experiment
from diffstack_mmv.commands.table_jobs import TableJobs, require_same_jobs
from dmmv_conventions.checks import require, require_at_least, require_one_of
from dmmv_conventions.config_files import names_in
from dmmv_conventions.configs import config_folder
from dmmv_conventions.targets import OF_A_RUN, require_buildable
from dmmv_conventions.yaml_files import read_plain

if TYPE_CHECKING:
    from diffstack_mmv.reporting import Run

logger = logging.getLogger(__name__)

ROWS = ("methods", "sets")


def check(config: DictConfig) -> None:
    """Refuse a table of nothing, and names that no command knows."""
    size, experiment = config.size, _experiment(config)
    for name, parts in (
        ("size.seeds", size.seeds), ("size.goals", size.goals), ("models", experiment.models),
        ("sets", experiment.sets),
    ):  # fmt: skip
        require(len(parts) > 0, name, "name at least one", "none")
    _require_each_once(size)
    require_at_least("size.epochs", size.epochs, 0)
    if size.pretraining is not None:
        require_at_least("size.pretraining.epochs", size.pretraining.epochs, 1)
        if size.pretraining.dynamics is not None:
            _require_option("dynamics", size.pretraining.dynamics)
    require_at_least("resamples", config.resamples, 1)
    require_one_of("rows", config.rows, ROWS)
    if config.rows == "sets":
        require(not config.plans, "plans", "be false with rows=sets, a table of predictions", True)
    for goal in size.goals:
        _require_option("goal", goal)
    for model in experiment.models:
        _require_option("dynamics", model)
    for name, told in experiment.sets.items():
        _require_conversion(experiment, name)
        _require_option("data", told.data)
        for vehicle in experiment.modes(name).values():
            _require_option("vehicle", vehicle)
        require_modes([str(mode) for mode in told.modes])
    instantiate(config.launcher)


def _require_each_once(size: DictConfig) -> None:
    for name in ("seeds", "goals"):
        given = list(size[name])
        require(len(set(given)) == len(given), f"size.{name}", "name each once", given)


def _require_conversion(experiment: Experiment, name: str) -> None:
    """Refuse a set that reads the conversion of other recordings."""
    source, sets = experiment.source(name), experiment.sets
    require_one_of(f"sets.{name}.converted", source, list(sets))
    for key in ("data", "root"):
        wanted = sets[source][key]
        requirement = f"be that of `sets.{source}`, whose conversion is read ({wanted})"
        found = sets[name][key]
        require(found == wanted, f"sets.{name}.{key}", requirement, found)


def _require_option(group: str, name: str) -> None:
    """Refuse what is neither an option of a group nor a file of one's own."""
    if not Path(name).is_file():
        require_one_of(group, name, names_in(config_folder() / group))


def admit(config: DictConfig) -> None:
    """Refuse a folder with results of other settings."""
    experiment = _experiment(config)
    stages = experiment.stages(_shown(experiment))
    require_same_jobs([job for jobs in stages for job in jobs])


@command(config_folder(), "results", check, admit)
def main(config: DictConfig) -> None:
    """Convert, train and evaluate whatever is not done yet, then write table and figures.

    Raises:
        ValueError: A job failed, or no data set has recordings.
    """
    experiment = _experiment(config)
    available, shown = experiment.available, _shown(experiment)
    absent = [f"{name}: no recordings in {told.root}." for name, told in experiment.sets.items()
              if name not in available]  # fmt: skip
    for each in absent:
        logger.info("Left out: %s", each)
    launcher = instantiate(config.launcher)
    work = TableJobs(experiment.stages(shown), launcher, "results", "job")
    work.tell(config.size.expected_s)
    if not config.dry_run:
        wanted = f"hold recordings of one of {', '.join(map(str, experiment.sets))}"
        require(len(shown) > 0, "raw", wanted, config.raw, "", "Give raw=FOLDER, see --help.")
        rows = [*shown, *experiment.ensembles(shown)]
        work.complete(lambda failures: _write(config, shown, rows, [*absent, *failures]))


def _experiment(config: DictConfig) -> Experiment:
    return Experiment(config, Path(config.out), Path(__file__).resolve().parent)


def _shown(experiment: Experiment) -> list[Run]:
    """Runs of the data sets that are there."""
    available = experiment.available
    return [run for run in experiment.runs() if run.data in available]


def _write(
    config: DictConfig, shown: Sequence[Run], rows: Sequence[Run], remarks: Sequence[str]
) -> None:
    """Table of what has ended, and figures of the runs that are no ensembles."""
    from diffstack_mmv.metrics import OPEN_LOOP
    from diffstack_mmv.reporting import (
        ablation_table,
        paper_table,
        prediction_table,
        write_paper_table,
    )

    out, titles = Path(config.out), _experiment(config).titles
    if config.plans:
        table = paper_table(rows, titles, OPEN_LOOP, config.resamples)
    else:
        arranged = {"methods": prediction_table, "sets": ablation_table}
        table = arranged[config.rows](rows, titles)
    write_paper_table(out, table, remarks)
    drawn = shown if config.plans else []
    _write_excitation([run for run in drawn if run.ended], out)
    for place in dict.fromkeys(run.place for run in drawn):
        side = [run for run in shown if run.place == place]
        _draw(config, [run for run in side if run.seed == config.size.seeds[0]], out)
    logger.info("\n%s", (out / "results.md").read_text(encoding="utf-8"))


def _write_excitation(judged: Sequence[Run], out: Path) -> None:
    """The models by how hard the human rode."""
    from diffstack_mmv.metrics import EXCITATION, OPEN_LOOP
    from diffstack_mmv.plotting import save_by_excitation
    from diffstack_mmv.reporting import bootstrap, paired_samples, write_by_excitation

    reports, sets = [run.report for run in judged], [run.data for run in judged]
    paired = paired_samples(reports, "plan_ade", EXCITATION, sets)
    write_by_excitation(out, paired)
    titles = {each.name: each.heading for each in EXCITATION}
    heading, picture = OPEN_LOOP["plan_ade"].heading, out / "excitation.png"
    save_by_excitation(picture, paired.by_setting(), paired.models, titles, heading, bootstrap)


def _draw(config: DictConfig, runs: Sequence[Run], out: Path) -> None:
    """The sample that is the median of the first model, as every model plans it."""
    from diffstack_mmv.callbacks import scenes_of
    from diffstack_mmv.data import split_windows
    from diffstack_mmv.plotting import draw_scenes, save_figure
    from diffstack_mmv.reporting import read_parquet
    from diffstack_mmv.stack import load_stack, outputs_of, representative

    ended = [run for run in runs if run.ended]
    if not ended:
        return
    samples = read_parquet(ended[0].report / "samples.parquet")
    number = representative(samples)[ended[0].mode]["median"]
    scenes = []
    for run in ended:
        stack = load_stack(run.report.parent / BEST)[0]
        data = instantiate(judged_data(_experiment(config), run))
        planned = outputs_of(stack, split_windows(data, config.split), [number])
        scenes += scenes_of(*planned, [config.models[run.model]])
    first = ended[0]
    name = f"{first.data}_{first.mode}_{first.goal}.png"
    save_figure(draw_scenes(scenes, columns=2), out / "figures" / name)


def judged_data(experiment: Experiment, run: Run) -> dict[str, Any]:
    """The data of the evaluation of a run, whose windows are numbered in `samples.parquet`.

    That of the training may have others. The cache is that of the results, which may have been
    moved since.
    """
    file = run.report / "config.yaml"
    module = read_plain(file, "out")["data"]["module"]
    require_buildable(module, OF_A_RUN, f"in {file}")
    cache = experiment.conversion(experiment.source(run.data)).result.parent
    module["source"]["folder"], module["export"]["folder"] = str(cache), str(cache / "exports")
    return module


if __name__ == "__main__":
    main()
