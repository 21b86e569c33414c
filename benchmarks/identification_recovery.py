"""Recovery of known parameters from recorded manoeuvres, seed by seed.

    python benchmarks/identification_recovery.py gm3 --controls measured --tied --seeds 20
    python benchmarks/identification_recovery.py gm3 --controls free --seeds 5
    python benchmarks/identification_recovery.py gm3 --controls measured --manoeuvres poor --seeds 5

    python benchmarks/identification_recovery.py kbm --controls measured --repeats 1 --smoother causal --starts 0 --seeds 12

Each seed draws a vehicle from the priors, drives it (where its model is of first order by steps of 5 ms), adds 2 cm of noise to each position, smooths positions as a conversion and
matches controls as `identify` would, and identifies it with the priors as they stand. Rows go to benchmarks/results/identification.jsonl, one per quantity and seed; `--table` writes
the table of all rows that are there.
"""

import argparse
import json
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from data_converters import (
    CausalSmoother,
    DrivenTrack,
    Sampling,
    Unsmoothed,
    ZeroPhaseSmoother,
    matched,
)
from diffstack_mmv.dynamics.catalogue import dynamics_names, model_of
from diffstack_mmv.dynamics.manoeuvres import Slalom, Turn
from diffstack_mmv.identification import (
    DataSplit,
    IdentifiabilityThresholds,
    Identifier,
    LevenbergMarquardt,
    ModelComparison,
    ParameterVector,
    TrackingSettings,
)
from diffstack_mmv.identification.inference.combinations import combinations, quantities
from diffstack_mmv.identification.shooting.wheel_positions import (
    free_positions,
    with_uncertain_positions,
)
from diffstack_mmv.identification.tracks.synthetic import (
    POOR_MANOEUVRES,
    RICH_MANOEUVRES,
    MeasurementModel,
    record_manoeuvres,
)
from diffstack_mmv.vehicles import load_vehicle

ROWS = Path(__file__).parent / "results" / "identification.jsonl"
TABLE = Path(__file__).parent / "results" / "identification.md"
NOISE_M = 0.02
CONTROL_NOISE = (0.05, 0.002)  # m/s^2, rad
STEP_S = 0.1
FINE_STEPS = 20
PREDICTED = 1  # of the samples that the shortest ride keeps; errors of prediction are not looked at
SMOOTHERS = {"none": Unsmoothed(), "causal": CausalSmoother(), "zero_phase": ZeroPhaseSmoother()}
QUICK = (
    Slalom(3.0, 0.30, 1.6, 6),
    Slalom(4.0, 0.22, 1.2, 8),
    Slalom(6.0, 0.12, 0.8, 12),
    Turn(5.0, 6.0, 5.5, 0.4, 1.0),
)
GENTLE = (
    Turn(5.0, 6.0, 5.5, 1.0, 1.0),
    Turn(7.0, -4.5, 10.0, 1.0, 1.0),
    Turn(6.0, 5.5, 7.5, 1.0, 1.0),
    Slalom(5.0, 0.10, 5.0, 2),
)
MANOEUVRES = {
    "rich": RICH_MANOEUVRES,
    "poor": POOR_MANOEUVRES,
    "quick": QUICK,
    "gentle": GENTLE,
}


def vehicle(name, tied):
    spec = load_vehicle(name)
    shared = {
        key: replace(value, tied=tied and value.length is not None)
        for key, value in spec.parameters.items()
    }
    return replace(spec, parameters=shared)


def rows_of(segment, rows):
    """Those rows of a segment."""
    motion = {key: getattr(segment, key)[rows] for key in ("position", "course", "speed")}
    controls = None if segment.controls is None else segment.controls[rows]
    return segment._replace(**motion, controls=controls)


def smoothed(segment, smoother):
    """A segment behind a smoother, as `identify` takes it from where on that has seen enough."""
    time_s = STEP_S * np.arange(len(segment.speed))
    position = torch.from_numpy(smoother(time_s, segment.position.numpy(), time_s).value)
    put_out = position.isfinite().all(-1)
    sampling = Sampling(STEP_S * int(put_out.int().argmax()), STEP_S)
    segment = rows_of(segment._replace(position=position), put_out)
    if segment.controls is None:
        return segment
    nowhere = np.zeros(len(segment.speed), dtype=bool)
    track = DrivenTrack(segment.position.numpy(), segment.controls.numpy(), nowhere)
    position, controls, _ = map(torch.from_numpy, matched(smoother, track, STEP_S, sampling))
    segment = segment._replace(position=position, controls=controls)
    return rows_of(segment, controls.isfinite().all(-1))


def recover(options, seed):
    """Rows of one seed."""
    generator = torch.Generator().manual_seed(seed)
    spec = with_uncertain_positions(vehicle(options.vehicle, options.tied))
    build = partial(model_of, spec, options.dynamics, STEP_S)
    finer = FINE_STEPS if build().acts_a_step_late and not options.own_steps else 1
    truth_model = model_of(spec, options.dynamics, STEP_S / finer).double()
    free_positions(truth_model, spec)
    learned = ParameterVector(truth_model, spec)
    truth = learned.prior.draw_values(generator)
    learned.store(learned.theta_for(truth))
    noise = CONTROL_NOISE if options.controls == "measured" else None
    measurement = MeasurementModel(NOISE_M, noise, finer)
    manoeuvres = MANOEUVRES[options.manoeuvres] * options.repeats
    smoother = SMOOTHERS[options.smoother]
    fitted, heldout = (
        [
            smoothed(segment, smoother)
            for segment in record_manoeuvres(truth_model, spec, each, measurement, generator)
        ]
        for each in (manoeuvres, manoeuvres[::7])
    )
    settings = TrackingSettings(NOISE_M, NOISE_M, 20.0, 2.0, control_noise=noise)
    identifier = Identifier(tracking=LevenbergMarquardt(30), starts=options.starts)
    compare = ModelComparison(spec, DataSplit(fitted, heldout), settings, identifier, PREDICTED)
    begin = time.perf_counter()
    problem, found, _ = compare(build)
    seconds = time.perf_counter() - begin
    values = problem.simulator.parameters.values(found.after.theta)
    names, std = problem.simulator.parameters.names, found.sensitivity.std
    rows = [
        (name, truth[i], values[i], std[i], found.identifiability[i])
        for i, name in enumerate(names)
    ]
    both = combinations(
        problem.simulator.vehicle.model,
        problem.simulator.parameters,
        found.optima,
        IdentifiabilityThresholds(),
    )
    exact = quantities(truth_model)
    rows += [(c.name, exact[i], c.estimate, c.std, c.verdict) for i, c in enumerate(both)]
    setting = {key: getattr(options, key) for key in SETTING} | {"seed": seed, "seconds": seconds}
    keys = ("name", "truth", "estimate", "std")
    return [
        setting
        | dict(zip(keys, (name, float(true), float(value), float(deviation)), strict=True))
        | {"verdict": str(verdict), "noise_factor": found.noise_factor, "optima": len(found.optima)}
        for name, true, value, deviation, verdict in rows
    ]


SETTING = (
    "vehicle",
    "dynamics",
    "controls",
    "smoother",
    "manoeuvres",
    "tied",
    "repeats",
    "own_steps",
)


def table():
    """One row per setting and quantity."""
    frame = pd.read_json(ROWS, lines=True).fillna({"smoother": "none", "own_steps": False})
    frame = frame.astype({"own_steps": bool})
    frame["signed"] = frame["estimate"] / frame["truth"] - 1
    frame["error"] = frame["signed"].abs()
    frame["covered"] = (frame["estimate"] - frame["truth"]).abs() <= 2 * frame["std"]
    frame["identifiable"] = frame["verdict"] == "identifiable"
    frame["weak"] = frame["verdict"] == "weakly identifiable"
    frame["largest_error"] = frame["error"].where(frame["identifiable"])
    groups = frame.groupby([*SETTING[1:], "name"], sort=False)
    return groups.agg(
        seeds=("seed", "nunique"),
        identifiable=("identifiable", "mean"),
        weakly=("weak", "mean"),
        median_error=("error", "median"),
        largest_error_if_identifiable=("largest_error", "max"),
        mean_error=("signed", "mean"),
        coverage=("covered", "mean"),
    ).reset_index()


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("dynamics", choices=dynamics_names())
    parser.add_argument("--vehicle", default="bicycle")
    parser.add_argument("--controls", choices=("measured", "free"), default="measured")
    parser.add_argument("--smoother", choices=tuple(SMOOTHERS), default="none")
    parser.add_argument("--manoeuvres", choices=tuple(MANOEUVRES), default="rich")
    parser.add_argument("--tied", action="store_true")
    parser.add_argument(
        "--own-steps", action="store_true", help="the vehicle moves by those of its model"
    )
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--starts", type=int, default=8, help="searches for other optima")
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        rows = recover(options, seed)
        with ROWS.open("a") as stream:
            stream.writelines(json.dumps(row) + "\n" for row in rows)
        told = sum(row["verdict"] == "identifiable" for row in rows)
        print(
            f"seed {seed}: {rows[0]['seconds']:.0f} s, {told} of {len(rows)} identifiable",
            flush=True,
        )
    if options.table:
        TABLE.write_text(table().to_markdown(index=False, floatfmt=".3f") + "\n")


if __name__ == "__main__":
    main()
