"""What has to be converted, trained and evaluated for the table of an experiment."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from diffstack_mmv.commands.command_line import quoted
from diffstack_mmv.commands.jobs import Job

if TYPE_CHECKING:
    from diffstack_mmv.reporting import Run

BEST = Path("checkpoints", "best.ckpt")
RESULT = Path("report", "metrics.json")
PREDICTOR = "predictor"
ENSEMBLE = "ensemble"


class Stages(NamedTuple):
    """Jobs that run side by side, in the order in which each stage needs those before."""

    conversions: list[Job]
    pretrainings: list[Job]  # of the predictor alone
    trainings: list[Job]
    ensembles: list[Job]


@dataclass(frozen=True)
class Experiment:
    """Data sets x modes x models x goals x seeds, each trained and evaluated.

    Attributes:
        config: Configuration of `results`.
        out: Folder of all results.
        scripts: Folder of the commands.
    """

    config: Any
    out: Path
    scripts: Path

    @property
    def models(self) -> dict[str, str]:
        """Models in the table; those set to null are left out."""
        told = self.config.models.items()
        return {str(name): title for name, title in told if title is not None}

    @property
    def titles(self) -> dict[str, str]:
        """Rows of the table: the models, and the ensembles of their seeds."""
        count, models = len(self.config.size.seeds), self.models
        mixed = {_mixed(name): f"{title}, ensemble of {count}" for name, title in models.items()}
        return models | mixed if self._mixes else models

    @property
    def _mixes(self) -> bool:
        return self.config.size.ensemble and len(self.config.size.seeds) > 1

    @property
    def sets(self) -> dict[str, Any]:
        """Data sets in the table; those set to null are left out."""
        return {str(name): told for name, told in self.config.sets.items() if told is not None}

    def modes(self, name: str) -> dict[str, str]:
        """Vehicle of each mode of a data set; modes set to null are left out."""
        told = self.config.sets[name].modes.items()
        return {str(mode): vehicle for mode, vehicle in told if vehicle is not None}

    @property
    def available(self) -> set[str]:
        """Data sets whose recordings can be had; those without a folder are generated."""
        roots = {name: told.root for name, told in self.sets.items()}
        return {name for name, root in roots.items() if root is None or Path(root).is_dir()}

    def runs(self) -> Iterator[Run]:
        """All runs of the table, also those of data sets that are not there."""
        from diffstack_mmv.reporting import Run

        size = self.config.size
        goals: Sequence[str] = size.goals if self.config.plans else size.goals[:1]
        seeds: Sequence[int] = size.seeds
        for name in self.sets:
            modes = self.modes(name)
            for mode, model, goal, seed in product(modes, self.models, goals, seeds):
                folder = self.out / "runs" / name / mode / model / goal / str(seed)
                yield Run(name, mode, model, goal, seed, folder / "report")

    def ensembles(self, runs: Sequence[Run]) -> list[Run]:
        """One for all seeds of a model, where they are asked for."""
        if not self._mixes:
            return []
        seed = self.config.size.seeds[0]
        return [
            run._replace(
                model=_mixed(run.model), report=run.report.parents[1] / ENSEMBLE / "report"
            )
            for run in runs
            if run.seed == seed
        ]

    def stages(self, runs: Sequence[Run]) -> Stages:
        """All that the table of these runs needs."""
        return Stages(
            conversions=self.conversions(sorted(self.available)),
            pretrainings=self.pretrainings(runs),
            trainings=[self.training(run) for run in runs],
            ensembles=[self.mixing(run) for run in self.ensembles(runs)],
        )

    def source(self, name: str) -> str:
        """Set whose conversion a set reads: its own unless it names another one."""
        return str(self.config.sets[name].get("converted", name))

    def conversions(self, names: Sequence[str]) -> list[Job]:
        """One for each set, or for several that differ in their training alone."""
        return [self.conversion(name) for name in dict.fromkeys(map(self.source, names))]

    def conversion(self, name: str) -> Job:
        """Conversion of a set, whose recordings are generated first if it has no folder."""
        told, folder = self.config.sets[name], self.out / "data" / name
        cache, root, commands = folder / "cache", folder / "recordings", []
        if told.root is None:
            commands.append(self._script("generate_sample", f"out={quoted(root)}", "seed=0"))
        else:
            root = Path(told.root).resolve()  # the same recordings, from wherever it is run
        data = f"data={told.data}", f"data.root={quoted(root)}", f"data.cache={quoted(cache)}"
        settings = *told.get("settings", []), *self.config.conversion
        place = f"out={quoted(folder / 'conversion')}"
        commands.append(self._script("convert", *data, *settings, place))
        result, log = cache / "conversion_report.json", self.out / "logs" / f"{name}.convert.log"
        lines = tuple(commands)
        return Job(
            f"convert {name}", "conversion", lines, result, log, folder=folder, root=self.out
        )

    def pretrainings(self, runs: Sequence[Run]) -> list[Job]:
        """The predictor alone: with the dynamics of each model, or once for all of them.

        Once for all goals of a data set, mode and seed.
        """
        told = self.config.size.pretraining
        if told is None or not self.config.plans:
            return []
        jobs = {}
        for run in runs:
            folder, dynamics = self._pretrained(run), told.dynamics or run.model
            first = run._replace(model=folder.parent.name, report=folder / "report")
            settings = [f"dynamics={dynamics}", "loss=prediction", f"epochs={told.epochs}"]
            settings += told.get("settings", [])
            jobs[first.report] = self._job(first, settings, plans=False)
        return list(jobs.values())

    def training(self, run: Run) -> Job:
        """Training of a run, from its predictor if that is trained alone first."""
        size = self.config.size
        settings, needs = [f"dynamics={run.model}", f"epochs={size.epochs}"], []
        if self.config.plans:
            settings += size.end_to_end
            if size.pretraining is not None:
                first = self._pretrained(run)
                settings.append(f"start={quoted(first / BEST)}")
                needs.append(first / RESULT)  # an interrupted training has weights, too
        return self._job(run, settings, needs, plans=self.config.plans)

    def mixing(self, run: Run) -> Job:
        """Evaluation of an ensemble of all seeds of a model."""
        folder = run.report.parent
        seeds = [folder.with_name(str(seed)) for seed in self.config.size.seeds]
        mixed = ",".join(quoted(seed / BEST) for seed in seeds[1:])
        plans = f"plans={str(self.config.plans).lower()}"
        judge = self._evaluation(run, seeds[0] / BEST, f"ensemble=[{mixed}]", plans)
        return self._written(run, (judge,), [seed / RESULT for seed in seeds])

    def _pretrained(self, run: Run) -> Path:
        """Folder of the predictor that a run starts from, beside those of the models."""
        shared = self.config.size.pretraining.dynamics is not None
        name = PREDICTOR if shared else f"{PREDICTOR}_{run.model}"
        return run.report.parents[3] / name / str(run.seed)

    def _job(
        self, run: Run, settings: Sequence[str], needs: Sequence[Path] = (), *, plans: bool
    ) -> Job:
        """Training with these settings, and evaluation of its best epoch."""
        config, told, folder = self.config, self.config.sets[run.data], run.report.parent
        small = config.size.overrides if config.plans else []
        vehicle = _vehicle(self.modes(run.data)[run.mode])
        asked = f"vehicle={vehicle}", f"goal={run.goal}", f"seed={run.seed}"
        train = self._script(
            "train", *self._data(run), *asked, f"out={quoted(folder)}", *small,
            *self._windows(run), *config.overrides, *settings, *told.get("training", []),
        )  # fmt: skip
        judge = self._evaluation(run, folder / BEST, f"plans={str(plans).lower()}")
        converted = self.conversion(self.source(run.data)).result
        return self._written(run, (train, judge), (converted, *needs))

    def _evaluation(self, run: Run, checkpoint: Path, *judged: str) -> tuple[str, ...]:
        place = f"out={quoted(run.report)}", f"split={self.config.split}"
        which = f"checkpoint={quoted(checkpoint)}"
        return self._script(
            "evaluate", *self._data(run), which, *judged, *place, *self._windows(run)
        )

    def _written(
        self, run: Run, commands: tuple[tuple[str, ...], ...], needs: Sequence[Path]
    ) -> Job:
        """The commands that end in the report of a run."""
        folder = run.report.parent
        name = ".".join(folder.relative_to(self.out / "runs").parts)
        return Job(
            name.replace(".", "/"), run.model, commands, folder / RESULT,
            self.out / "logs" / f"{name}.log", tuple(needs), folder, self.out,
        )  # fmt: skip

    def _data(self, run: Run) -> tuple[str, ...]:
        """Recordings of a run, and who in them counts."""
        cache = quoted(self.conversion(self.source(run.data)).result.parent)
        name = self.config.sets[run.data].data
        return f"data={name}", f"data.cache={cache}", f"modes=[{run.mode}]"

    def _windows(self, run: Run) -> tuple[str, ...]:
        """Settings of the windows, of training and evaluation alike."""
        return *self.config.sets[run.data].get("settings", []), *self.config.windows

    def _script(self, name: str, *arguments: str) -> tuple[str, ...]:
        return (sys.executable, str(self.scripts / f"{name}.py"), *arguments)


def _vehicle(name: str) -> str:
    """An option of the group as it is, the path of a file in quotes."""
    return quoted(name) if Path(name).is_file() else name


def _mixed(model: str) -> str:
    return f"{model}_{ENSEMBLE}"
