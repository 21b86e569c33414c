"""Whole checkpoints of a training, in which one thing was exchanged."""

import copy
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import torch

from benchmarks.faults.trial import Result, Trial, each
from benchmarks.faults.workplace import checkpoint, stack_content
from diffstack_mmv.callbacks import resume_point
from diffstack_mmv.stack import load_stack, start_from

HOSTILE = ("pathlib.Path.touch", "diffstack_mmv.stack.checkpoint.torch.load", "hydra.utils.call")
SPELT = (
    " pathlib.Path.touch", "pathlib.Path.touch ", "pathlib..Path.touch", "pathlib.Path", "builtins.print", "",
    "diffstack_mmv.stack.__class__", "diffstack_mmv.stack.module.__builtins__.eval", "torch.nn.Module", "torch.optim.os.remove",
    "diffstack_mmv.vehicles.load_vehicle.__globals__", ["pathlib.Path.touch"], {"_target_": "pathlib.Path.touch"},
)  # fmt: skip


@cache
def whole() -> dict[str, Any]:
    """The content of a checkpoint."""
    return stack_content()


def nodes(content: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Places of all nodes of a configuration that are built."""
    if isinstance(content, dict):
        if "_target_" in content:
            yield place
        for key, value in content.items():
            yield from nodes(value, (*place, key))
    elif isinstance(content, list):
        for number, value in enumerate(content):
            yield from nodes(value, (*place, number))


def at(content: Any, place: tuple[Any, ...]) -> Any:
    """The node of a place."""
    for key in place:
        content = content[key]
    return content


def loaded(change: Callable[[dict[str, Any], Path], None], folder: Path) -> Result:
    """Load a changed checkpoint; nothing of it may have run."""
    content, mark = copy.deepcopy(whole()), folder / "mark"
    change(content, mark)
    torch.save(content, folder / "a.ckpt")
    try:
        load_stack(folder / "a.ckpt")
    finally:
        if mark.exists():
            raise AssertionError("code ran")
    return Result.SILENT


def exchanged(place: tuple[Any, ...], target: Any, content: dict[str, Any], mark: Path) -> None:
    """Let a node build something else."""
    node = at(content["provenance"]["config"]["stack"], place)
    node["_target_"], node["_args_"] = target, [str(mark)]


def added(wrap: Callable[[Any], Any], content: dict[str, Any], mark: Path) -> None:
    """Hide a hostile node somewhere else in the stack."""
    node = {"_target_": "pathlib.Path.touch", "_args_": [str(mark)]}
    content["provenance"]["config"]["stack"]["hidden"] = wrap(node)


WRAPS: dict[str, Callable[[Any], Any]] = {
    "in an unknown key": lambda node: node,
    "in a list": lambda node: [node],
    "in lists of lists": lambda node: [[[node]]],
    "in a mapping of mappings": lambda node: {"a": {"b": node}},
    "in a tuple": lambda node: (node,),
    "as a partial": lambda node: node | {"_partial_": True},
    "not to be built": lambda node: {"_recursive_": False, "a": node},
    "under a class of ours": lambda node: {
        "_target_": "diffstack_mmv.planning.FutureGoal",
        "a": node,
    },
}


def weights(change: Callable[[dict[str, Any], str], None], folder: Path) -> Result:
    """Load a checkpoint whose weights were changed."""
    content = copy.deepcopy(whole())
    state = content["state_dict"]
    change(state, next(name for name, value in state.items() if value.is_floating_point()))
    torch.save(content, folder / "a.ckpt")
    load_stack(folder / "a.ckpt")
    return Result.SILENT


WEIGHTS: dict[str, Callable[[dict[str, Any], str], None]] = {
    "one is missing": lambda state, name: state.pop(name),
    "one too many": lambda state, name: state.update(horse=torch.zeros(3)),
    "another shape": lambda state, name: state.update({name: torch.zeros(7, 7)}),
    "NaN": lambda state, name: state.update({name: state[name] * torch.nan}),
    "a number": lambda state, name: state.update({name: 1.0}),
    "text": lambda state, name: state.update({name: "x"}),
    "none": lambda state, name: state.clear(),
    "complex numbers": lambda state, name: state.update(
        {name: torch.zeros(7, 7, dtype=torch.cfloat)}
    ),
}


def damaged() -> Iterator[tuple[str, bytes]]:
    """A whole checkpoint that was cut off or changed."""
    content = checkpoint().read_bytes()
    for part in range(1, 20):
        place = part * len(content) // 20
        yield f"cut at {5 * part} %", content[:place]
        changed = bytes([content[place] ^ 255])
        yield f"a byte changed at {5 * part} %", content[:place] + changed + content[place + 1 :]


def read(use: Callable[[Path], Any], content: bytes, folder: Path) -> Result:
    """Use a damaged checkpoint; a byte between the parts of the archive changes nothing."""
    path = folder / "checkpoints" / "last.ckpt"
    path.parent.mkdir()
    path.write_bytes(content)
    use(path)
    found = torch.load(path, weights_only=True)
    expected = whole()["state_dict"]
    same = all(torch.equal(found["state_dict"][name], expected[name]) for name in expected)
    alike = found["provenance"]["config"] == whole()["provenance"]["config"]
    return Result.HELD if same and alike else Result.SILENT


def resumed(path: Path) -> None:
    """Where a training would go on."""
    resume_point(path, whole()["provenance"]["config"])


def started(path: Path) -> None:
    """Start another stack from the weights."""
    start_from(load_stack(checkpoint()).stack, path)


def trials() -> Iterator[Trial]:
    """All faults of whole checkpoints."""
    places = list(nodes(whole()["provenance"]["config"]["stack"]))
    for target in HOSTILE:
        named = (
            (f"{target} at {'.'.join(map(str, place)) or 'the top'}",
             partial(loaded, partial(exchanged, place, target)))
            for place in places
        )  # fmt: skip
        yield from each("replayed checkpoints", named)
    spelt = ((f"target {t!r}", partial(loaded, partial(exchanged, (), t))) for t in SPELT)
    yield from each("replayed checkpoints", spelt)
    hidden = ((f"hidden {n}", partial(loaded, partial(added, wrap))) for n, wrap in WRAPS.items())
    yield from each("replayed checkpoints", hidden)
    yield from each("weights", ((n, partial(weights, c)) for n, c in WEIGHTS.items()))
    for name, use in {"load": load_stack, "resume": resumed, "start": started}.items():
        named = ((f"{name}: {n}", partial(read, use, c)) for n, c in damaged())
        yield from each("damage of a whole checkpoint", named)
