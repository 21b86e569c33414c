"""Tables beside recordings that tell their scale, broken, and folders that lack a part."""

import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from benchmarks.faults.crowds import CROWDS, replace, whole, write
from benchmarks.faults.tables import NO_FILES, Content
from benchmarks.faults.trial import Result, Trial, converted, each
from data_converters import ConversionSettings, DutDataset, EthUcyDataset, SddDataset, convert

BY_WRITER = {crowd.writer: crowd for crowd in CROWDS}
SCALES = "scene,video,metres_per_pixel,certainty\n"
GOOD = "".join(f"gates,video{number},0.04,1.0\n" for number in range(3))
BAD = "".join(f"{line}\n" for line in GOOD.splitlines()[:2])
VALUES = ("", "nan", "one", "0", "-0.04", "inf", "1e300", "1e-400", "40")
NO_TABLES: dict[str, Content] = {
    "empty": "",
    "a web page": "<html></html>",
    "zero bytes": "\0" * 100,
    "rows of more columns than the header": SCALES + GOOD + "gates,video3,0.04,1.0,7\n",
    "other columns": "a,b\n1,2\n",
    "no UTF-8": b"\xff\xfe\x00" * 99,
    "a folder": Path.mkdir,
}


def one_scale(row: str, folder: Path) -> Result:
    """Convert three videos, of which the scale of one is broken; the others have to be kept."""
    crowd = BY_WRITER["sdd"]
    write(crowd, folder)
    (folder / "scales.csv").write_text(SCALES + BAD + row)
    sample = whole(crowd)
    # the fresh video, and the one without a scale
    return converted(SddDataset(folder), folder, sample.agents - 4, sample.told)


def no_scales(name: str, content: Content, folder: Path) -> Result:
    """Convert recordings with a table of scales that is none."""
    crowd = BY_WRITER[name]
    write(crowd, folder)
    for path in folder.glob("filtered/*.gz"):
        shutil.move(path, path.parents[1] / path.name)
    place = folder / ("scales.csv" if name == "sdd" else "ratios.csv")
    replace(place, content)
    if name == "dut":
        path = folder / "raw" / "crossing_01_ped.csv"
        path.parent.mkdir()
        path.write_text("id,frame,label,x,y\n" + "0,1,ped,28.0,28.0\n" * 30)
    dataset = SddDataset(folder) if name == "sdd" else DutDataset(folder)
    convert(ConversionSettings(dataset, folder / "cache", progress=False))
    return Result.SILENT


def raw_ratio(row: str, folder: Path) -> Result:
    """Convert clips, of which one has raw pixels and a broken scale."""
    crowd = BY_WRITER["dut"]
    write(crowd, folder)
    rows = "".join(f"0,{frame},ped,{1.2 * frame},28.0\n" for frame in range(264))
    path = folder / "raw" / "crossing_09_ped.csv"
    path.parent.mkdir()
    path.write_text("id,frame,label,x,y\n" + rows)
    (folder / "ratios.csv").write_text("clip,pixels_per_metre\ncrossing_08,28.0\n" + row)
    sample = whole(crowd)
    return converted(DutDataset(folder), folder, sample.agents - 1, sample.told)


def lacking(part: str, change: Callable[[Path], object], folder: Path) -> Result:
    """Convert ETH/UCY without one of its parts."""
    write(BY_WRITER["eth_ucy"], folder)
    change(folder / part)
    convert(ConversionSettings(EthUcyDataset(folder), folder / "cache", progress=False))
    return Result.SILENT


def emptied(path: Path) -> None:
    """Leave a folder without its files."""
    shutil.rmtree(path)
    path.mkdir()


def file_instead(path: Path) -> None:
    """Put a file in the place of a folder."""
    shutil.rmtree(path)
    path.write_text("")


def trials() -> Iterator[Trial]:
    """All faults of what stands beside recordings."""
    rows = {f"scale of '{value}'": f"gates,video2,{value},1.0\n" for value in VALUES}
    rows |= {f"certainty of '{v}'": f"gates,video2,0.04,{v}\n" for v in ("", "nan", "one", "-1")}
    rows |= {"no scale": "", "two scales": "gates,video2,0.04,1.0\ngates,video2,0.05,1.0\n"}
    yield from each("scales of videos", ((n, partial(one_scale, row)) for n, row in rows.items()))
    ratios = {f"ratio of '{value}'": f"crossing_09,{value}\n" for value in VALUES[:-1]}
    ratios |= {"no ratio": "", "two ratios": "crossing_09,28.0\ncrossing_09,14.0\n"}
    yield from each("scales of videos", ((n, partial(raw_ratio, row)) for n, row in ratios.items()))
    for name in ("sdd", "dut"):
        tables = NO_TABLES | {"a dangling link": NO_FILES["a dangling link"]}
        faults = ((f"{n}, {name}", partial(no_scales, name, c)) for n, c in tables.items())
        yield from each("tables of scales", faults)
    changes = {"no": shutil.rmtree, "an empty": emptied, "a file as": file_instead}
    for part in ("all_data", "train", "val"):
        faults = ((f"{n} folder {part}", partial(lacking, part, c)) for n, c in changes.items())
        yield from each("parts of ETH/UCY", faults)
