"""The paper's table by one command."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

from diffstack_mmv.cli import DictConfig, command, instantiate
from diffstack_mmv.command_line import quoted
from diffstack_mmv.data_checks import require_modes
from diffstack_mmv.jobs import Job, Launcher, expected_seconds, require_same_jobs, run_all
from dmmv_conventions.checks import require, require_at_least, require_one_of
from dmmv_conventions.configs import config_folder

if TYPE_CHECKING:
    from diffstack_mmv.reporting import Run

logger = logging.getLogger(__name__)

SCRIPTS = Path(__file__).resolve().parent
BEST = Path("checkpoints", "best.ckpt")
RESULT = Path("report", "metrics.json")
PREDICTOR = "predictor"
ROWS = ("methods", "sets")


def check(config: DictConfig) -> None:
    """Refuse a table of nothing, and names that no command knows."""
    size = config.size
    for name, parts in (
        ("size.seeds", size.seeds), ("size.goals", size.goals), ("models", config.models),
        ("sets", config.sets),
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
    for model in _models(config):
        _require_option("dynamics", model)
    # a set or model of null is left out
    for name, told in config.sets.items():
        if told is None:
            continue
        _require_conversion(config, name)
        _require_option("data", told.data)
        for vehicle in told.modes.values():
            _require_option("vehicle", vehicle)
        require_modes([str(mode) for mode in told.modes])
    instantiate(config.launcher)


def _require_each_once(size: DictConfig) -> None:
    for name in ("seeds", "goals"):
        given = list(size[name])
        require(len(set(given)) == len(given), f"size.{name}", "name each once", given)


def _require_conversion(config: DictConfig, name: str) -> None:
    """Refuse a set that reads the conversion of other recordings."""
    source, told = _converted(config, name), config.sets[name]
    there = [other for other, each in config.sets.items() if each is not None]
    require_one_of(f"sets.{name}.converted", source, there)
    for key in ("data", "root"):
        wanted = config.sets[source][key]
        requirement = f"be that of `sets.{source}`, whose conversion is read ({wanted})"
        require(told[key] == wanted, f"sets.{name}.{key}", requirement, told[key])


def _require_option(group: str, name: str) -> None:
    """Refuse what is neither an option of a group nor a file of one's own."""
    known = sorted(path.stem for path in (config_folder() / group).glob("*.yaml"))
    if not Path(name).is_file():
        require_one_of(group, name, known)


def admit(config: DictConfig) -> None:
    """Refuse a folder with results of other settings."""
    out = Path(config.out)
    runs = [run for run in _runs(config, out) if run.data in _available(config)]
    require_same_jobs([job for jobs in _jobs(config, runs, out) for job in jobs])


@command(config_folder(), "results", check, admit)
def main(config: DictConfig) -> None:
    """Convert, train and evaluate whatever is not done yet, then write table and figures.

    Raises:
        ValueError: A job failed.
    """
    from diffstack_mmv.metrics import OPEN_LOOP
    from diffstack_mmv.reporting import (
        ablation_table,
        paper_table,
        prediction_table,
        write_paper_table,
    )

    out, models = Path(config.out), _models(config)
    wanted, available = _wanted(config), _available(config)
    absent = [f"{name}: no recordings in {told.root}." for name, told in wanted.items()
              if name not in available]  # fmt: skip
    for each in absent:
        logger.info("Left out: %s", each)
    shown = [run for run in _runs(config, out) if run.data in available]
    converted, begun, trained = _jobs(config, shown, out)
    launcher: Launcher = instantiate(config.launcher)
    _tell(config, [*converted, *begun, *trained], launcher.width)
    if config.dry_run:
        return
    stages = converted, begun, trained
    failed = [job for jobs in stages for job in run_all(launcher, jobs, "results", "job")]
    remarks = [*absent, *(_told(job) for job in failed)]
    if config.plans:
        table = paper_table(shown, models, OPEN_LOOP, config.resamples)
    else:
        arranged = ablation_table if config.rows == "sets" else prediction_table
        table = arranged(shown, models)
    write_paper_table(out, table, remarks)
    drawn = shown if config.plans else []
    _write_excitation([run for run in drawn if (run.report / "metrics.json").is_file()], out)
    for data, mode, goal in dict.fromkeys((run.data, run.mode, run.goal) for run in drawn):
        side = [run for run in shown if (run.data, run.mode, run.goal) == (data, mode, goal)]
        _draw(config, [run for run in side if run.seed == config.size.seeds[0]], out)
    logger.info("\n%s", (out / "results.md").read_text(encoding="utf-8"))
    if failed:
        count = len(converted) + len(begun) + len(trained)
        raise ValueError(f"{len(failed)} of {count} jobs failed or were not begun. " +
                         "Read their logs, then give the same command again.")  # fmt: skip


def _models(config: DictConfig) -> dict[str, str]:
    """Models in the table; those set to null are left out."""
    return {str(name): title for name, title in config.models.items() if title is not None}


def _wanted(config: DictConfig) -> dict[str, DictConfig]:
    """Data sets in the table; those set to null are left out."""
    return {str(name): told for name, told in config.sets.items() if told is not None}


def _available(config: DictConfig) -> set[str]:
    """Data sets whose recordings can be had."""
    return {name for name, told in _wanted(config).items() if _is_there(told.root)}


def _jobs(
    config: DictConfig, runs: Sequence[Run], out: Path
) -> tuple[list[Job], list[Job], list[Job]]:
    """Conversions, trainings of the predictor alone, and trainings; each needs those before."""
    trained = [_training(config, run, out) for run in runs]
    converted = _conversions(config, sorted(_available(config)), out)
    return converted, _pretrainings(config, runs, out), trained


def _is_there(root: str | None) -> bool:
    """Whether recordings can be had; those without a folder are generated."""
    return root is None or Path(root).is_dir()


def _runs(config: DictConfig, out: Path) -> Iterator[Run]:
    from diffstack_mmv.reporting import Run

    goals = config.size.goals if config.plans else config.size.goals[:1]
    for name, told in config.sets.items():
        if told is None:
            continue
        places = product(told.modes, _models(config), goals, config.size.seeds)
        for mode, model, goal, seed in places:
            folder = out / "runs" / name / mode / model / goal / str(seed)
            yield Run(str(name), mode, model, goal, seed, folder / "report")


def _script(name: str, *arguments: str) -> tuple[str, ...]:
    return (sys.executable, str(SCRIPTS / f"{name}.py"), *arguments)


def _converted(config: DictConfig, name: str) -> str:
    """Set whose conversion a set reads: its own unless it names another one."""
    return str(config.sets[name].get("converted", name))


def _conversions(config: DictConfig, names: Sequence[str], out: Path) -> list[Job]:
    """One for each set, or for several that differ in their training alone."""
    sources = dict.fromkeys(_converted(config, name) for name in names)
    return [_conversion(config, name, out) for name in sources]


def _conversion(config: DictConfig, name: str, out: Path) -> Job:
    told, folder = config.sets[name], out / "data" / name
    cache, root, commands = folder / "cache", folder / "recordings", []
    if told.root is None:
        commands.append(_script("generate_sample", f"out={quoted(root)}", "seed=0"))
    else:
        root = Path(told.root).resolve()  # the same recordings, from wherever it is run
    data = f"data={told.data}", f"data.root={quoted(root)}", f"data.cache={quoted(cache)}"
    settings = *told.get("settings", []), *config.conversion
    place = f"out={quoted(folder / 'conversion')}"
    commands.append(_script("convert", *data, *settings, place))
    result = cache / "conversion_report.json"
    log = out / "logs" / f"{name}.convert.log"
    return Job(
        f"convert {name}", "conversion", tuple(commands), result, log, folder=folder, root=out
    )


def _pretrainings(config: DictConfig, runs: Sequence[Run], out: Path) -> list[Job]:
    """The predictor alone: with the dynamics of each model, or once for all of them.

    Once for all goals of a data set, mode and seed.
    """
    told = config.size.pretraining
    if told is None or not config.plans:
        return []
    jobs = {}
    for run in runs:
        folder, dynamics = _pretrained(config, run), told.dynamics or run.model
        first = run._replace(model=folder.parent.name, report=folder / "report")
        settings = [f"dynamics={dynamics}", "loss=prediction", f"epochs={told.epochs}"]
        settings += told.get("settings", [])
        jobs[first.report] = _job(config, first, out, settings, plans=False)
    return list(jobs.values())


def _pretrained(config: DictConfig, run: Run) -> Path:
    """Folder of the predictor that a run starts from, beside those of the models."""
    shared = config.size.pretraining.dynamics is not None
    name = PREDICTOR if shared else f"{PREDICTOR}_{run.model}"
    return run.report.parents[3] / name / str(run.seed)


def _training(config: DictConfig, run: Run, out: Path) -> Job:
    settings, needs = [f"dynamics={run.model}", f"epochs={config.size.epochs}"], []
    if config.plans:
        settings += config.size.end_to_end
        if config.size.pretraining is not None:
            first = _pretrained(config, run)
            settings.append(f"start={quoted(first / BEST)}")
            needs.append(first / RESULT)  # an interrupted training has weights, too
    return _job(config, run, out, settings, needs, plans=config.plans)


def _job(
    config: DictConfig, run: Run, out: Path, settings: Sequence[str], needs: Sequence[Path] = (),
    *, plans: bool,
) -> Job:  # fmt: skip
    """Training with these settings, and evaluation of its best epoch."""
    told, folder = config.sets[run.data], run.report.parent
    source = _converted(config, run.data)
    cache = quoted(out / "data" / source / "cache")
    data = f"data={told.data}", f"data.cache={cache}"
    windows = *told.get("settings", []), *config.windows
    small = config.size.overrides if config.plans else []
    who = f"modes=[{run.mode}]"
    asked = f"vehicle={_vehicle(told.modes[run.mode])}", f"goal={run.goal}", f"seed={run.seed}"
    train = _script(
        "train", *data, who, *asked, f"out={quoted(folder)}", *small, *windows, *config.overrides,
        *told.get("training", []), *settings,
    )  # fmt: skip
    judged = f"checkpoint={quoted(folder / BEST)}", f"plans={str(plans).lower()}"
    place = f"out={quoted(run.report)}"
    evaluate = _script("evaluate", *data, who, *judged, place, f"split={config.split}", *windows)
    name = ".".join(folder.relative_to(out / "runs").parts)
    return Job(
        name.replace(".", "/"), run.model, (train, evaluate), folder / RESULT,
        out / "logs" / f"{name}.log", (_conversion(config, source, out).result, *needs),
        folder, out,
    )  # fmt: skip


def _vehicle(name: str) -> str:
    """An option of the group as it is, the path of a file in quotes."""
    return quoted(name) if Path(name).is_file() else name


def _tell(config: DictConfig, jobs: Sequence[Job], width: int) -> None:
    still = [job for job in jobs if not job.done]
    seconds = expected_seconds(jobs, jobs, config.size.expected_s, width)
    logger.info(
        "%d of %d jobs to do, %d at a time: about %.1f hours on cores like those measured before.",
        len(still), len(jobs), width, seconds / 3600,
    )  # fmt: skip
    for job in still:
        logger.debug("%s", job.name)


def _told(job: Job) -> str:
    """Why there is no result."""
    if job.lacking:
        return f"{job.name} was not begun: {job.lacking[0]} is not there."
    return f"{job.name} failed: see {job.log}."


def _write_excitation(judged: Sequence[Run], out: Path) -> None:
    """The models by how hard the human rode."""
    from diffstack_mmv.metrics import EXCITATION, OPEN_LOOP
    from diffstack_mmv.plotting import save_by_excitation
    from diffstack_mmv.reporting import bootstrap, paired_samples, write_by_excitation

    reports, sets = [run.report for run in judged], [run.data for run in judged]
    paired = paired_samples(reports, "plan_ade", EXCITATION, sets)
    write_by_excitation(out, paired)
    titles, heading = (
        {each.name: each.heading for each in EXCITATION},
        OPEN_LOOP["plan_ade"].heading,
    )
    picture = out / "excitation.png"
    save_by_excitation(picture, paired.by_setting(), paired.models, titles, heading, bootstrap)


def _draw(config: DictConfig, runs: Sequence[Run], out: Path) -> None:
    """The sample that is the median of the first model, as every model plans it."""
    from diffstack_mmv.callbacks import scenes_of
    from diffstack_mmv.data import split_windows
    from diffstack_mmv.plotting import draw_scenes, save_figure
    from diffstack_mmv.reporting import read_parquet
    from diffstack_mmv.stack import load_stack, outputs_of, representative

    ended = [run for run in runs if (run.report / "metrics.json").is_file()]
    if not ended:
        return
    samples = read_parquet(ended[0].report / "samples.parquet")
    number = representative(samples)[ended[0].mode]["median"]
    scenes = []
    for run in ended:
        path = run.report.parent / "checkpoints" / "best.ckpt"
        stack, trained = load_stack(path)
        data = instantiate(trained["data"]["module"])
        planned = outputs_of(stack, split_windows(data, config.split), [number])
        scenes += scenes_of(*planned, [config.models[run.model]])
    first = ended[0]
    name = f"{first.data}_{first.mode}_{first.goal}.png"
    save_figure(draw_scenes(scenes, columns=2), out / "figures" / name)


if __name__ == "__main__":
    main()
