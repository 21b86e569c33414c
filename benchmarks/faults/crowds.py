"""Recordings of many agents in tables: ETH/UCY, CITR, DUT, SDD and tables of one's own, broken."""

import gzip
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import mkdtemp
from typing import NamedTuple

from benchmarks.faults.tables import (
    NO_FILES,
    Content,
    Layout,
    Rows,
    column,
    put,
    spoiled,
    spoiled_rows,
)
from benchmarks.faults.trial import Result, Trial, Usual, converted, each, told_by
from data_converters import (
    CitrDataset,
    ConversionSettings,
    DutDataset,
    EthUcyDataset,
    SddDataset,
    TableDataset,
    convert,
)
from data_converters.recordings import RecordingDataset
from tests.data_converters.synthetic import WRITERS

CLIP = ("id", "frame", "label", "x_est", "y_est", "vx_est", "vy_est")
BOX = ("id", "xmin", "ymin", "xmax", "ymax", "frame", "lost", "occluded", "generated", "label")
OWN = ("time", "agent", "type", "x", "y")


class Crowd(NamedTuple):
    """A data set: a file of its sample, and how its rows tell agent, time and place."""

    kind: str
    writer: str
    build: Callable[[Path], RecordingDataset]
    file: str
    fresh: str
    """A file that the sample does not have, for an agent alone."""
    layout: Layout
    agent: int
    time: int
    place: int
    label: int | None = None

    def rows(self, root: Path) -> Rows:
        """All rows of the file of the sample."""
        path = root / self.file
        packed = path.with_name(path.name + ".gz")
        whole = (
            gzip.decompress(packed.read_bytes()).decode() if packed.exists() else path.read_text()
        )
        lines = whole.splitlines()[1 if self.layout.headed else 0 :]
        return [list(line.split(self.layout.separator)) for line in lines]


CROWDS = (
    Crowd(
        "ETH/UCY scenes", "eth_ucy", EthUcyDataset, "train/a_train.txt", "train/b_train.txt",
        Layout(("frame", "id", "x", "y"), "\t", headed=False), 1, 0, 2,
    ),
    Crowd(
        "CITR clips", "citr", CitrDataset, "filtered/crossing_01_ped.csv",
        "filtered/crossing_04_ped.csv", Layout(CLIP), 0, 1, 3,
    ),
    Crowd(
        "DUT clips", "dut", DutDataset, "filtered/crossing_01_ped.csv",
        "filtered/crossing_04_ped.csv", Layout(CLIP), 0, 1, 3,
    ),
    Crowd(
        "SDD videos", "sdd", SddDataset, "gates/video0/annotations.txt",
        "gates/video3/annotations.txt", Layout(BOX, " ", headed=False), 0, 5, 1, 9,
    ),
    Crowd(
        "tables of one's own", "csv", partial(TableDataset, types={"bike": "bicycle", "e-scooter": "scooter"}),
        "day_1.csv", "day_9.csv", Layout(OWN), 1, 0, 3, 2,
    ),
)  # fmt: skip


class Sample(NamedTuple):
    """A whole sample, the agents in it, and what a conversion tells of it with the fresh file."""

    root: Path
    agents: int
    told: Usual


def write(crowd: Crowd, root: Path) -> Rows:
    """Write the sample; rows of its first agent, who is to be alone in the fresh file."""
    WRITERS[crowd.writer](root)
    if crowd.writer == "sdd":
        with (root / "scales.csv").open("a") as scales:
            scales.write("\ngates,video3,0.04,1.0\n")
    rows = crowd.rows(root)
    return [row for row in rows if row[crowd.agent] == rows[0][crowd.agent]]


@cache
def whole(crowd: Crowd) -> Sample:
    """The sample, converted once."""
    root = Path(mkdtemp())
    alone = write(crowd, root)
    replace(root / crowd.fresh, crowd.layout.text(alone))
    settings = ConversionSettings(crowd.build(root), Path(mkdtemp()), progress=False)
    report = convert(settings)
    agents = sum(sum(scene.agents.values()) for scene in report.scenes)
    return Sample(root, agents, told_by(report))


def replace(path: Path, content: Content) -> None:
    """Put what is to be tried in the place of a file, gzipped or not."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_name(path.name + ".gz").unlink(missing_ok=True)
    path.unlink(missing_ok=True)
    put(path, content)


def alone(crowd: Crowd, content: Content, folder: Path) -> Result:
    """Convert the sample with one more file, which is broken."""
    write(crowd, folder)
    replace(folder / crowd.fresh, content)
    sample = whole(crowd)
    return converted(crowd.build(folder), folder, sample.agents - 1, sample.told)


def packed(crowd: Crowd, content: bytes, folder: Path) -> Result:
    """Convert the sample with one more gzipped file, which is broken."""
    write(crowd, folder)
    path = folder / f"{crowd.fresh}.gz"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    sample = whole(crowd)
    return converted(crowd.build(folder), folder, sample.agents - 1, sample.told)


def among_others(crowd: Crowd, rows: Rows, folder: Path) -> Result:
    """Convert the sample with one broken agent among the others of a file."""
    first = write(crowd, folder)
    replace(folder / crowd.fresh, crowd.layout.text(first))
    others = [row for row in crowd.rows(folder) if row[crowd.agent] != first[0][crowd.agent]]
    # most agents of a file have to be right, or nobody can say who is wrong
    twin = [[*row[: crowd.agent], "77", *row[crowd.agent + 1 :]] for row in first]
    replace(folder / crowd.file, crowd.layout.text([*others, *twin, *rows]))
    sample = whole(crowd)
    return converted(crowd.build(folder), folder, sample.agents, sample.told)


def gzipped(text: str) -> Iterator[tuple[str, bytes]]:
    """Gzipped files that are not whole."""
    content = gzip.compress(text.encode(), mtime=0)
    yield "gzip cut in the middle", content[: len(content) // 2]
    yield "gzip cut at its end", content[:-4]
    yield "gzip of a wrong checksum", content[:-8] + bytes(4) + content[-4:]
    yield "gzip with a changed byte", content[:200] + bytes([content[200] ^ 255]) + content[201:]
    yield "no gzip", text.encode()
    yield "empty gzip", b""


def named(crowd: Crowd, rows: Rows) -> Iterator[tuple[str, Rows]]:
    """Rows of an agent whose name or class cannot be."""
    half = len(rows) // 2
    if crowd.writer != "csv":
        for name, value in {"NaN": "nan", "text as a": "one", "infinite": "inf", "no": ""}.items():
            yield f"{name} number of the agent", column(rows, crowd.agent, lambda x, i, v=value: v)
    if crowd.label is not None:
        at = crowd.label
        for name, value in {"unknown": '"Horse"', "no": '""', "number as a": "7"}.items():
            yield f"{name} class", [[*row[:at], value, *row[at + 1 :]] for row in rows]
        other = '"Cart"' if crowd.writer == "sdd" else "bike"
        changed = [[*row[:at], other, *row[at + 1 :]] for row in rows[half:]]
        yield "two classes", [*rows[:half], *changed]


def trials() -> Iterator[Trial]:
    """All faults of these files."""
    for crowd in CROWDS:
        rows = write(crowd, Path(mkdtemp()))
        contents: dict[str, Content] = {
            **spoiled(crowd.layout, rows, crowd.time, crowd.place),
            **NO_FILES,
        }
        yield from each(crowd.kind, ((n, partial(alone, crowd, c)) for n, c in contents.items()))
        archives = gzipped(crowd.layout.text(rows))
        yield from each(crowd.kind, ((n, partial(packed, crowd, c)) for n, c in archives))
        if crowd.writer == "dut":
            continue  # read by the same lines as those of CITR
        broken = [*spoiled_rows(rows, crowd.time, crowd.place), *named(crowd, rows)]
        yield from each(
            f"{crowd.kind}: one agent among others",
            ((n, partial(among_others, crowd, c)) for n, c in broken),
        )
