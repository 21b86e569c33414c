"""Recovery of known vehicles and instruments from synthetic rides like those of the Autobike.

    python benchmarks/identification_measured_recovery.py kbm --seeds 20

Each seed draws vehicle, antenna and the instruments of every recording from their priors, measures rides with the noise of
the real ones, and fits. Prints how many 95 % intervals contain the truth.
"""

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import torch

from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.identification.measured import (
    InstrumentPriors,
    MeasuredFitter,
    MeasurementNoise,
    RideSimulator,
    RideWindowSettings,
    cut_windows,
)
from diffstack_mmv.identification.measured.synthetic import record_rides
from diffstack_mmv.identification.shooting import ParameterVector
from diffstack_mmv.vehicles import load_vehicle

WITHIN = 1.96
ROWS = Path(__file__).parent / "results" / "identification_measured.jsonl"
REAL = MeasurementNoise(along_m=0.021, across_m=0.011, curvature=0.0068, speed_share=0.024)


def recover(dynamics, seed, recordings, steps):
    """Errors over deviations of shared unknowns and of those of the recordings."""
    generator = torch.Generator().manual_seed(seed)
    spec, priors = load_vehicle("autobike"), InstrumentPriors()
    model = model_of(spec, dynamics, 0.1).double()
    vector = ParameterVector(model, spec)
    simulator = RideSimulator(model, vector, REAL, spec)
    found = record_rides(simulator, priors, recordings, steps, generator)
    windows = cut_windows(found.rides, replace(RideWindowSettings(), jump_m=9.0))
    fit = MeasuredFitter(priors)(simulator, windows)
    count = len(vector)
    values = [vector.values(each[:count]) for each in (fit.point.shared, found.shared)]
    errors = torch.cat([values[0] - values[1], (fit.point.shared - found.shared)[count:]])
    names = [*vector.names, "antenna_ahead", "antenna_height", "steer_gain"]
    order = [int(name.rpartition("_")[2]) for name in windows.names]
    own = (fit.point.recording - found.recording[order]) / fit.recording_std
    found_errors = dict(zip(names, (errors / fit.shared_std).tolist(), strict=True))
    quantity = simulator.steer_per_curvature
    apart = quantity(fit.point.shared) - quantity(found.shared)
    found_errors["steer_per_curvature"] = float(apart) / fit.std_of(quantity)
    return found_errors, own, fit


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("dynamics", nargs="?", default="kbm")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--recordings", type=int, default=8)
    parser.add_argument("--steps", type=int, default=260)
    parser.add_argument("--rows", type=Path, default=ROWS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    begin, rows, inside = time.process_time(), [], []
    for seed in range(options.seeds):
        shared, own, fit = recover(options.dynamics, seed, options.recordings, options.steps)
        rows.append({"dynamics": options.dynamics, "seed": seed, **shared})
        inside.append((own.abs() <= WITHIN).double().mean(0))
        told = {name: round(value, 2) for name, value in shared.items()}
        print(seed, fit.iterations, told, file=sys.stderr, flush=True)
    names = ("steer_offset", "steer_scale", "speed_scale", "delay_s")
    columns = [name for name in rows[0] if name not in ("dynamics", "seed")]
    print("\n| unknown | 95 % intervals with the truth | rms of error / deviation |")
    print("|---|---|---|")
    for name in columns:
        values = torch.tensor([row[name] for row in rows])
        share, size = (values.abs() <= WITHIN).double().mean(), values.square().mean().sqrt()
        print(f"| {name} | {float(share):.3f} | {float(size):.2f} |")
    for name, share in zip(names, torch.stack(inside).mean(0).tolist(), strict=True):
        print(f"| {name}, per recording | {share:.3f} | |")
    shared = [abs(row[name]) <= WITHIN for row in rows for name in columns]
    total = sum(shared) + float(torch.stack(inside).sum()) * options.recordings
    number = len(shared) + len(names) * options.recordings * options.seeds
    cpu = time.process_time() - begin
    print(f"| **all {number}** | {total / number:.3f} | |\n\n{cpu:.0f} s of one core")
    with options.rows.open("a") as stream:
        stream.writelines(json.dumps(row) + "\n" for row in rows)


if __name__ == "__main__":
    main()
