"""Checkpoints that are hostile, damaged or of another program; caches likewise."""

import json
import pickle
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import torch

from benchmarks.faults.trial import Result, Trial, each
from diffstack_mmv.callbacks import resume_point
from diffstack_mmv.stack import load_stack
from diffstack_mmv.vehicles import load_vehicle
from dmmv_conventions.cache import read_state

TARGETS = (
    "os.system", "builtins.eval", "builtins.open", "pathlib.Path.write_text", "subprocess.Popen",
    "shutil.rmtree", "hydra.utils.instantiate", "hydra.utils.call", "hydra.utils.get_method",
    "importlib.import_module", "functools.partial", "torch.load", "torch.hub.load", "numpy.load",
    "pickle.loads", "yaml.unsafe_load", "pytorch_lightning.Trainer",
    "diffstack_mmv.commands.cli.sys.exit", "diffstack_mmv.stack.checkpoint.instantiate",
    "diffstack_mmv.stack.load_predictor", "diffstack_mmv.vehicles.save_vehicle",
    "data_converters.imptc.download.download_imptc", "data_converters.cache.write_json",
    "dmmv_conventions.opening.CachedUnifiedDataset", "diffstack_mmv.nowhere.Nothing", 7, None,
)  # fmt: skip


class Runs:
    """Writes a file when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return eval, (f"open({str(self.mark)!r}, 'w').close()",)


def whole(stack: Any) -> dict[str, Any]:
    """A checkpoint with this description of a stack."""
    return {"provenance": {"config": {"stack": stack}}, "state_dict": {"a": torch.zeros(50)}}


def loaded(content: Any, folder: Path) -> Result:
    """Load a checkpoint."""
    path = folder / "a.ckpt"
    path.write_bytes(content) if isinstance(content, bytes) else torch.save(content, path)
    load_stack(path)
    return Result.SILENT


def building(target: Any, nested: bool, folder: Path) -> Result:
    """Load a checkpoint that names what is built from it."""
    mark = folder / "mark"
    node: Any = {"_target_": target, "_args_": [str(mark)]}
    if nested:
        node = {"_target_": "diffstack_mmv.stack.assemble", "planner": {"cost": [node]}}
    try:
        return loaded(whole(node), folder)
    finally:
        if mark.exists():
            raise AssertionError("code ran")


def pickled(zipped: bool, folder: Path) -> Result:
    """Load a pickle that runs code."""
    mark = folder / "mark"
    content: Any = {"state_dict": Runs(mark)} if zipped else pickle.dumps(Runs(mark))
    try:
        return loaded(content, folder)
    finally:
        if mark.exists():
            raise AssertionError("code ran")


def damaged() -> Iterator[tuple[str, bytes]]:
    """Checkpoints that were cut off or changed."""
    path = Path("/dev/shm" if Path("/dev/shm").is_dir() else "/tmp") / "faults.ckpt"
    torch.save(whole({"_target_": "diffstack_mmv.stack.assemble"}), path)
    content = path.read_bytes()
    path.unlink()
    for part in range(1, 10):
        yield f"cut at {part}0 %", content[: part * len(content) // 10]
    for part in range(1, 10):
        place = part * len(content) // 10
        yield (
            f"a byte changed at {part}0 %",
            content[:place] + bytes([content[place] ^ 255]) + content[place + 1 :],
        )
    yield "empty", b""
    yield "text", b"no checkpoint"


def resumed(content: bytes, folder: Path) -> Result:
    """Resume from a checkpoint."""
    last = folder / "checkpoints" / "last.ckpt"
    last.parent.mkdir()
    last.write_bytes(content)
    resume_point(last, {"seed": 1})
    return Result.SILENT


PARTS: dict[str, Any] = {
    "nothing": {},
    "a list": [1],
    "no provenance": {"state_dict": {}},
    "no weights": {"provenance": {"config": {"stack": {}}}},
    "no stack": {"provenance": {"config": {}}, "state_dict": {}},
    "weights that are numbers": whole({}) | {"state_dict": {"a": 1}},
    "a vehicle instead of a stack": whole(
        {"_target_": "diffstack_mmv.vehicles.load_vehicle", "_args_": ["bicycle"]}
    ),
    "an interpolation": whole({"_target_": "${oc.env:HOME}"}),
    "a hidden node": whole({"a": "${oc.create:{_target_: os.system}}"}),
    "an argument too many": whole({"_target_": "diffstack_mmv.stack.assemble", "horse": 1}),
}


def vehicle(content: str, folder: Path) -> Result:
    """Load a vehicle file."""
    (folder / "mine.yaml").write_text(content)
    load_vehicle(folder / "mine.yaml")
    return Result.SILENT


VEHICLES = {
    "no YAML": "a: [1",
    "a list": "[1]",
    "empty": "",
    "unknown keys": "name: x\nhorse: 1",
    "nested deep": "a: " + "[" * 5000,
    "aliases that explode": "a: &a0 [1]\n"
    + "".join(f"b{n}: &a{n + 1} [{', '.join([f'*a{n}'] * 10)}]\n" for n in range(9)),
    "an object of Python": "a: !!python/object/apply:os.system [ls]",
    "a target": "name: {_target_: os.system}",
    "a target of ours": "name: {_target_: diffstack_mmv.dynamics.DiffKBM}",
    "an unknown interpolation": "name: ${nowhere}",
}


def state(content: str, folder: Path) -> Result:
    """Read the state of a cache."""
    (folder / "toy").mkdir()
    (folder / "toy" / "cache.json").write_text(content)
    read_state(folder, "toy")
    return Result.SILENT


STATES = {
    "no JSON": "{",
    "a list": "[]",
    "nested deep": "[" * 100_000,
    "of another version": json.dumps({"format_version": 9, "complete": True}),
    "unfinished": json.dumps({"format_version": 1, "complete": False}),
    "empty": "",
}


def trials() -> Iterator[Trial]:
    """All faults of checkpoints, vehicle files and caches."""
    for depth, nested in (("at the top", False), ("nested", True)):
        named = ((f"{t} {depth}", partial(building, t, nested)) for t in TARGETS)
        yield from each("hostile checkpoints", named)
    pickles = (("pickle", partial(pickled, False)), ("pickle in a zip", partial(pickled, True)))
    yield from each("hostile checkpoints", pickles)
    yield from each(
        "checkpoints without their parts", ((n, partial(loaded, c)) for n, c in PARTS.items())
    )
    yield from each("damaged checkpoints", ((n, partial(loaded, c)) for n, c in damaged()))
    yield from each("resuming from damage", ((n, partial(resumed, c)) for n, c in damaged()))
    yield from each("vehicle files", ((n, partial(vehicle, c)) for n, c in VEHICLES.items()))
    yield from each("states of caches", ((n, partial(state, c)) for n, c in STATES.items()))
