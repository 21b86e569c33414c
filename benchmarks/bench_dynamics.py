"""Time of one control step of 4096 vehicles in float32: DiffGM3 beside DiffKBM, eager and compiled.

`python benchmarks/bench_dynamics.py` prints the table of error and gradient against cost instead.
"""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from diffstack_mmv.dynamics import DiffGM3, DiffKBM, rollout
from diffstack_mmv.dynamics.gm3 import LIM2, ExplicitEuler, RungeKutta4
from diffstack_mmv.vehicles import VehicleSpec, load_vehicle

BATCH = 4096
REFERENCE = Path(__file__).resolve().parents[2] / "shared" / "reference" / "gm3"
VEHICLES = ("bicycle", "scooter", "tricycle", "wheelchair", "cart", "skateboard")
METHODS = [
    ("LIM2", LIM2(), (1, 2, 4)),
    ("explicit Euler", ExplicitEuler(), (1, 5, 20)),
    ("RK4", RungeKutta4(), (5, 20)),
]
HEADER = "| method | steps | median cm | p95 cm | max cm | gradient | cosine | operations |"


@pytest.mark.parametrize("compiled", [False, True], ids=["eager", "compiled"])
@pytest.mark.parametrize("vehicle", ["bicycle", "cart", "wheelchair"])
@pytest.mark.parametrize("kind", [DiffKBM, DiffGM3])
def test_step_of_a_batch(benchmark, kind, vehicle, compiled):
    model = kind(load_vehicle(vehicle)).requires_grad_(False)
    state = torch.randn(BATCH, model.state_dim)
    control = 0.3 * torch.randn(BATCH, model.control_dim)
    step = torch.compile(model, fullgraph=True) if compiled else model
    step(state, control)
    benchmark(step, state, control)


@pytest.mark.parametrize("kind", [DiffKBM, DiffGM3])
def test_rollout_and_gradient_of_a_batch(benchmark, kind):
    model = kind(load_vehicle("bicycle"))
    state = torch.randn(256, model.state_dim)
    controls = (0.1 * torch.randn(256, 30, model.control_dim)).requires_grad_()

    def run():
        return torch.autograd.grad(rollout(model, state, controls)[:, -1].sum(), controls)

    benchmark(run)


class OperationCount(TorchDispatchMode):
    """Count tensor operations, views included."""

    def __init__(self):
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, function, types, arguments=(), keywords=None):
        self.count += 1
        return function(*arguments, **(keywords or {}))


def operations(stepper, substeps):
    model = DiffGM3(load_vehicle("bicycle"), substeps=substeps, stepper=stepper)
    with torch.no_grad(), OperationCount() as counter:
        model(torch.zeros(4, 8), torch.zeros(4, 2))
    return counter.count


def sequences(vehicle):
    with np.load(REFERENCE / f"traj_{vehicle}.npz") as stored:
        return {key: torch.as_tensor(stored[key]) for key in ("x0", "u", "x", "regular")}


def evaluate(vehicle, stepper, substeps):
    """Position errors over 3 s, and ∂p_T/∂u over 30 steps, of every regular sequence."""
    entry = json.loads((REFERENCE / "vehicles.json").read_text())[vehicle]
    model = DiffGM3(VehicleSpec.from_reference(entry), substeps=substeps, stepper=stepper)
    model.double().requires_grad_(False)
    stored = sequences(vehicle)
    controls = stored["u"][:, :30].clone().requires_grad_()
    states = rollout(model, stored["x0"], controls)
    rows = [
        torch.autograd.grad(states[:, -1, axis].sum(), controls, retain_graph=True)[0]
        for axis in (0, 1)
    ]
    error = (states.detach() - stored["x"][:, :31])[..., :2].norm(dim=-1).amax(1)
    return error[stored["regular"]], torch.stack(rows, 1).flatten(1)[stored["regular"]]


def row(name, stepper, substeps, converged):
    """One row of the table: errors, gradient norm ratio (p95 / max), cosine (p5 / min)."""
    errors, ratios, cosines = [], [], []
    for vehicle, exact in converged.items():
        error, gradient = evaluate(vehicle, stepper, substeps)
        gradient = gradient.nan_to_num(1e9, 1e9, -1e9)
        errors.append(100 * error.nan_to_num(1e9))
        ratios.append(gradient.norm(dim=1) / exact.norm(dim=1))
        cosines.append(torch.nn.functional.cosine_similarity(gradient, exact, dim=1))
    error, ratio, cosine = (torch.cat(each) for each in (errors, ratios, cosines))
    cells = [
        name,
        substeps,
        *(f"{value:.3g}" for value in (error.median(), error.quantile(0.95), error.max())),
        f"{ratio.quantile(0.95):.3g} / {ratio.max():.3g}",
        f"{cosine.quantile(0.05):.3g} / {cosine.min():.3g}",
        operations(stepper, substeps),
    ]
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def main():
    converged = {vehicle: evaluate(vehicle, LIM2(), 16)[1] for vehicle in VEHICLES}
    print(HEADER, "|---" * 8 + "|", sep="\n")
    for name, stepper, counts in METHODS:
        for substeps in counts:
            print(row(name, stepper, substeps, converged), flush=True)


if __name__ == "__main__":
    main()
