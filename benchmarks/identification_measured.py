"""Everything about the identification from measured steering, one stage after the other.

    python benchmarks/identification_measured.py RECORDINGS OUT            # what is not done yet
    python benchmarks/identification_measured.py RECORDINGS OUT --only identify
    python benchmarks/identification_measured.py RECORDINGS OUT --list     # tell the stages, and stop

RECORDINGS holds the folders `autobike` and `two_wheeler` of the recordings. Stages: conversions, fits and held-out roll-outs of
DiffKBM, unicycle and DiffGM3 (both tyre laws), recovery of known vehicles, laws of lean. A stage that is done is skipped, and one
that was interrupted goes on where it was: fits and roll-outs are kept one by one under OUT/identify/parts. Results:
OUT/identify/identification.{md,json}, a CSV per table, vehicle.yaml; OUT/recovery.md; OUT/lean_*.{md,png}; OUT/seconds.json.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from dmmv_conventions.disk import replacing

ROOT = Path(__file__).resolve().parents[1]
ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}


class Stage(NamedTuple):
    """One command, what it makes, and whether its output is that."""

    name: str
    command: list[str]
    makes: str
    prints: bool = False


def stages(recordings, out):
    """All stages in their order."""

    def convert(data, smoother):
        name = f"{data}_{smoother}"
        told = [f"data={data}", f"data.root={recordings / data}", f"data.cache={out / name}"]
        made = f"{name}/conversion_report.json"
        return Stage(name, ["scripts/convert.py", *told, f"smoother={smoother}"], made)

    identify = [
        "scripts/identify.py", "data=autobike", f"data.cache={out / 'autobike_none'}", "vehicle=autobike", "dynamics=kbm",
        "+dynamics@others.gm3=gm3", "+dynamics@others.gm3_paper=gm3_paper", "controls=measured",
        "splits=[train,val,test]", f"out={out / 'identify'}",
    ]  # fmt: skip
    lean = {"two_wheeler": ["bicycle", "scooter", "motorcycle"], "autobike": ["autobike"]}
    return [
        convert("autobike", "none"),
        convert("autobike", "zero_phase"),
        convert("two_wheeler", "zero_phase"),
        *(
            Stage(
                f"lean_{name}",
                ["benchmarks/lean_laws.py", name, str(out / f"{name}_zero_phase"), *vehicles,
                 "--figure", str(out / f"lean_{name}.png")],
                f"lean_{name}.md",
                prints=True,
            )
            for name, vehicles in lean.items()
        ),
        Stage("identify", identify, "identify/vehicle.yaml"),
        Stage(
            "recovery",
            ["benchmarks/identification_measured_recovery.py", "kbm", "--rows", str(out / "recovery.jsonl")],
            "recovery.md",
            prints=True,
        ),
    ]  # fmt: skip


def run(stage, out):
    """Run a stage; its output takes its place when it is whole."""
    print(f"{stage.name}: {' '.join(stage.command)}", flush=True)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command, place = [sys.executable, *stage.command], out / stage.makes
    environment = os.environ | ONE_THREAD
    if stage.prints:
        with replacing(place) as unfinished, unfinished.open("w") as stream:
            subprocess.run(command, cwd=ROOT, env=environment, stdout=stream, check=True)
    else:
        subprocess.run(command, cwd=ROOT, env=environment, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("recordings", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="+", default=[])
    parser.add_argument("--list", action="store_true")
    options = parser.parse_args()
    recordings, out = options.recordings.resolve(), options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    told = out / "seconds.json"
    seconds = json.loads(told.read_text()) if told.is_file() else {}
    every = stages(recordings, out)
    for number, stage in enumerate(every, 1):
        done = (out / stage.makes).is_file()
        wanted = not options.only or stage.name in options.only
        print(f"[{number}/{len(every)}] {stage.name}: {'done' if done else 'to do'}", flush=True)
        if done or options.list or not wanted:
            continue
        seconds[stage.name] = seconds.get(stage.name, 0.0) + run(stage, out)
        told.write_text(json.dumps(seconds, indent=2) + "\n")
    print(f"processor seconds: {seconds}")


if __name__ == "__main__":
    main()
