"""Numbers that no solver, model or world can work with."""

from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.faults.trial import Result, Trial, each
from diffstack_mmv.control import ILQR, Solution
from diffstack_mmv.dynamics import DiffKBM
from diffstack_mmv.simulation import (
    CircleCrossing,
    ExactVerdict,
    HolonomicRobot,
    OrcaCrowd,
    World,
)  # fmt: skip
from diffstack_mmv.vehicles import load_vehicle, vehicle_names

BAD, PROBLEMS = 1, 3
VALUES = {"NaN": float("nan"), "inf": float("inf"), "-inf": -float("inf"), "1e300": 1e300}


@cache
def model(vehicle: str) -> DiffKBM:
    """The model of a vehicle, in float64."""
    return DiffKBM(load_vehicle(vehicle)).double()


def solved(place: str, column: int, value: float | None) -> Solution:
    """Three problems, one of which may be broken."""
    kbm = model("bicycle")
    state = torch.tensor([[0.0, 0.0, 0.0, 3.0]]).repeat(PROBLEMS, 1).double()
    goal = torch.tensor([[8.0, 3.0]]).repeat(PROBLEMS, 1).double()
    guess = torch.zeros(PROBLEMS, 10, 2).double()
    if value is not None:
        {"state": state, "goal": goal, "guess": guess[:, 0]}[place][BAD, column] = value

    def cost(states: Tensor, controls: Tensor) -> Tensor:
        return (states[..., :2] - goal[:, None]).square().sum(-1) + controls.square().sum(-1)

    with torch.no_grad():
        return ILQR(max_iterations=5)(kbm, cost, kbm.bounds, state, guess)


@cache
def clean() -> Solution:
    """The answers without a fault."""
    return solved("state", 0, None)


def isolated(place: str, column: int, value: float, folder: Path) -> Result:
    """A broken problem must be told and leave its mates alone."""
    found, others = solved(place, column, value), torch.arange(PROBLEMS) != BAD
    if not torch.equal(found.controls[others], clean().controls[others]):
        return Result.LOST
    if not found.converged[BAD]:
        return Result.REPORTED
    # a guess is brought into the box
    finite = found.states[BAD].isfinite().all() and found.controls[BAD].isfinite().all()
    harmless = place == "guess" and value == value
    return Result.HELD if finite and harmless else Result.SILENT


def acted(value: float, folder: Path) -> Result:
    """An action that is no number."""
    world = World(HolonomicRobot(), OrcaCrowd(), ExactVerdict(3.0), 0.25)
    state = world.start(CircleCrossing(humans=2).cases("test", [0, 1]))
    world.step(state, torch.tensor([[0.0, 0.0], [value, 0.0]]).double())
    return Result.SILENT


def driven(vehicle: str, share: float, folder: Path) -> Result:
    """A vehicle at one of its limits for a thousand steps."""
    kbm = model(vehicle)
    lower, upper = (bound.double() for bound in kbm.bounds)
    state = torch.zeros(1, 4).double()
    with torch.no_grad():
        for _ in range(1000):
            state = kbm(state, (lower + share * (upper - lower))[None])
    return Result.HELD if state.isfinite().all() else Result.SILENT


def trials() -> Iterator[Trial]:
    """All impossible numbers."""
    places = [("state", c) for c in range(4)] + [
        ("goal", 0),
        ("goal", 1),
        ("guess", 0),
        ("guess", 1),
    ]
    yield from each(
        "inputs of the solver",
        (
            (f"{name} in {place} {c}", partial(isolated, place, c, value))
            for place, c in places
            for name, value in VALUES.items()
        ),
    )
    actions = ((name, partial(acted, value)) for name, value in list(VALUES.items())[:3])
    yield from each("actions", actions)
    limits = (
        (f"{vehicle} at {share:g} of its range", partial(driven, vehicle, share))
        for vehicle in vehicle_names()
        for share in (0.0, 1.0)
    )
    yield from each("vehicles at their limits", limits)
