"""Gradient table: exact, without the curvature of the dynamics, and against finite differences on every model.

    python benchmarks/bench_solver_gradients.py > benchmarks/results/gradients.md

The first table needs the reference solutions in ../shared, see the tests of the same problems.
"""

import argparse
import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from diffstack_mmv.dynamics import DiffGM3, DiffKBM, ExtendedUnicycle  # noqa: E402
from tests.control import test_models, test_reference  # noqa: E402

GROUPS = {"cost weights": slice(0, 7), "wheelbase": slice(7, 8), "goal": slice(8, 10)}
KINDS = [(ExtendedUnicycle, ("bicycle",)), (DiffKBM, ("bicycle",)), (DiffGM3, test_models.VEHICLES)]


def reference():
    """The module of the reference problems, and its files by name."""
    folder = ROOT.parent / "shared" / "reference" / "mpc"
    spec = importlib.util.spec_from_file_location("reference_problems", folder / "problems.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module, lambda name: np.load(folder / f"{name}.npz")


def errors(found, expected):
    """Relative error of each instance."""
    return np.linalg.norm(found - expected, axis=(1, 2)) / np.linalg.norm(
        expected, axis=(1, 2)
    ).clip(1e-12)


def against_reference():
    """Median and largest relative error on 64 instances of each problem."""
    given = reference()
    print(
        "| problem | by | instances | exact: median | exact: max | Gauss-Newton: median | Gauss-Newton: over 10 % |"
    )
    print("|---|---|---|---|---|---|---|")
    for name in test_reference.PROBLEMS:
        file = given[1](f"gradient_{name}")
        exact = test_reference.jacobian(given, name)
        with pytest.MonkeyPatch.context() as patch:
            test_reference.drop_dynamics_curvature(patch)
            rough = test_reference.jacobian(given, name)
        for group, columns in GROUPS.items():
            if name == "P1" and group == "wheelbase":
                continue
            for label, rows in (
                ("free", ~file["act"].astype(bool)),
                ("active bounds", file["act"].astype(bool)),
            ):
                wanted = file["Jimp"][rows][..., columns]
                fine = errors(exact[rows][..., columns], wanted)
                crude = errors(rough[rows][..., columns], wanted)
                print(
                    f"| {name} | {group} | {rows.sum()} {label} | {np.median(fine):.1e} | {fine.max():.1e} "
                    f"| {np.median(crude):.1%} | {np.mean(crude > 0.1):.0%} |"
                )


def against_differences(chosen):
    """Relative error against central differences along a direction, for each hidden tensor."""
    print(
        "\n| model | vehicle | bounds | state | goal | weight | agent | physical parameters: worst |"
    )
    print("|---|---|---|---|---|---|---|---|")
    everything = []
    for kind, vehicles in KINDS:
        for vehicle in [each for each in vehicles if each in chosen]:
            for tight in (False, True):
                cells, parameters = differences(kind, vehicle, tight)
                everything += cells + list(parameters.values())
                worst = max(parameters, key=parameters.get, default=None)
                last = f"{parameters[worst]:.1e} ({worst}, of {len(parameters)})" if worst else "-"
                bounds = "active" if tight else "free"
                shown = " | ".join([*(f"{cell:.1e}" for cell in cells), last])
                print(f"| {kind.__name__} | {vehicle} | {bounds} | {shown} |", flush=True)
    print(
        f"\n{len(everything)} derivatives: median {np.median(everything):.1e}, largest {max(everything):.1e}."
    )


def differences(kind, vehicle, tight):
    """Errors for the hidden tensors, and for each physical parameter by name."""
    model, box, hidden, guess = test_models.solved_with_gradient(kind, vehicle, tight)

    def error(tensor):
        return test_models.error_along_a_direction(model, box, hidden, guess, [tensor])

    learned = {name: value for name, value in model.named_parameters() if value.grad is not None}
    parameters = {name.removesuffix(".offset"): error(value) for name, value in learned.items()}
    return [error(value) for value in hidden.values()], parameters


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", nargs="+", default=test_models.VEHICLES)
    arguments = parser.parse_args()
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    against_reference()
    against_differences(arguments.vehicles)
