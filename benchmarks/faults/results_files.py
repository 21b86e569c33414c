"""Folders of finished runs whose files are lost, cut off or changed, and recorded controls."""

import json
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.faults.caches import LOST, damage
from benchmarks.faults.tables import NO_FILES, Content, put
from benchmarks.faults.trial import Result, Trial, each
from benchmarks.faults.workplace import base, evaluated, navigated, said, simulated

Change = Callable[[dict[str, Any]], Any]
JSONS: dict[str, Change] = {
    "a list": lambda content: [content],
    "empty": lambda content: {},
    "null in everything": lambda content: dict.fromkeys(content),
    "text in everything": lambda content: dict.fromkeys(content, "x"),
    "numbers in everything": lambda content: dict.fromkeys(content, 7),
    "lists in everything": lambda content: dict.fromkeys(content, []),
}
RUNS: dict[str, tuple[Callable[[], Path], tuple[str, ...]]] = {
    "evaluate": (evaluated, ("metrics.json",)),
    "navigate": (navigated, ("closed_loop.json",)),
}
TEXTS = {"nested deep": "[" * 100_000, "zero bytes": "\0" * 999, "text": "no JSON", "empty": ""}


def failing(script: str, arguments: list[str], folder: Path) -> Result:
    """Run a command that has to fail."""
    told = said(script, [*arguments, f"out={folder / 'out'}"])
    if told is None:
        return Result.SILENT
    raise ValueError(told)


def report(run: Callable[[], Path], file: str, content: Content, folder: Path) -> Result:
    """Make a page of a run with a broken file."""
    place = Path(shutil.copytree(run(), folder / "run"))
    damage(place / file, content)
    return failing("report", [f"runs=[{place}]"], folder)


def compare(file: str, content: Content | None, folder: Path) -> Result:
    """Compare a broken run with itself."""
    place = Path(shutil.copytree(evaluated(), folder / "run"))
    damage(place / file, content)
    return failing("compare", [f"runs=[{place}]", "wandb=none"], folder)


def against(content: Content | None, folder: Path) -> Result:
    """Drive against a run that is broken."""
    place = Path(shutil.copytree(navigated(), folder / "run"))
    damage(place / "closed_loop.json", content)
    return failing("navigate", [*base("navigate"), f"against=[{place}]"], folder)


def controls(content: Content, folder: Path) -> Result:
    """Drive recorded controls that cannot be."""
    put(folder / "controls.csv", content)
    return failing("simulate", [*base("simulate"), f"controls={folder / 'controls.csv'}"], folder)


def changed(path: Path) -> dict[str, str]:
    """Broken contents of a JSON file by name."""
    content = json.loads(path.read_text())
    whole = path.read_text()
    told = {name: json.dumps(change(content)) for name, change in JSONS.items()}
    return told | TEXTS | {"cut off": whole[: len(whole) // 2]}


def settings(name: str, value: object) -> str:
    """The file of a drive that was made under another setting."""
    return json.dumps(json.loads((navigated() / "closed_loop.json").read_text()) | {name: value})


def table(**columns: object) -> str:
    """Recorded controls as text."""
    rows = {"acceleration_mps2": [0.1] * 20, "steer_rad": [0.05] * 20} | columns
    return pd.DataFrame(rows).to_csv(index=False)


def recorded() -> Iterator[tuple[str, Content]]:
    """Recorded controls that cannot be."""
    for name in ("acceleration_mps2", "steer_rad"):
        for told, value in {"NaN": "nan", "infinite": "inf", "text as": "left", "no": ""}.items():
            yield f"{told} {name}", table(**{name: [value] * 20})
        yield f"no column {name}", table().replace(name, "other")
    yield "degrees", table(steer_rad=[20.0] * 20)
    yield "header only", "acceleration_mps2,steer_rad\n"
    yield "a row cut off", table() + "0.1\n"
    yield "rows with more columns", table() + "0.1,0.1,0.1\n"
    yield "semicolons", table().replace(",", ";")
    yield "zero bytes", "\0" * 999
    yield from NO_FILES.items()


def samples() -> dict[str, Content | None]:
    """Broken tables of samples."""
    whole = (evaluated() / "samples.parquet").read_bytes()
    return LOST | {"cut off": whole[: len(whole) // 2], "cut at its end": whole[:-4]}


def trials() -> Iterator[Trial]:
    """All faults of results and of recorded controls."""
    for name, (run, files) in RUNS.items():
        for file in files:
            contents = changed(run() / file).items()
            named = ((f"{file}: {n}", partial(report, run, file, c)) for n, c in contents)
            yield from each(f"pages of {name}", named)
    log = "no,table\n" * 3
    drives = {"empty": "", "other columns": log, "zero bytes": "\0" * 99, **NO_FILES}
    names = ((f"trajectory_kbm.csv: {n}", c) for n, c in drives.items())
    yield from each(
        "pages of simulate",
        ((n, partial(report, simulated, "trajectory_kbm.csv", c)) for n, c in names),
    )
    contents = changed(evaluated() / "metrics.json").items()
    named = ((f"metrics.json: {n}", partial(compare, "metrics.json", c)) for n, c in contents)
    yield from each("comparisons", named)
    named = (
        (f"samples: {n}", partial(compare, "samples.parquet", c)) for n, c in samples().items()
    )
    yield from each("comparisons", named)
    contents = changed(navigated() / "closed_loop.json")
    contents |= {
        f"another {name}": settings(name, value)
        for name, value in {"scenario": "square", "humans": 9, "dt_s": 0.1, "limit_s": 9.0}.items()
    }
    contents["no case in common"] = settings("cases", [])
    yield from each("earlier drives", ((n, partial(against, c)) for n, c in contents.items()))
    yield from each("recorded controls", ((n, partial(controls, c)) for n, c in recorded()))
