"""Roll-outs from the state of the moving-horizon estimator beside those from a history of two seconds.

    python benchmarks/ego_estimator.py CACHE PARTS

CACHE and PARTS are those of scripts/identify.py with controls=measured: the fit of DiffKBM to all recordings is found there, if it
is one of this version.
Each recording is driven through by `EgoEstimator` under the vehicle and the priors that the other recordings tell, from the
start of its first roll-out on. The estimator knows no more than a history does, but it remembers the instruments.
"""

import argparse
import sys
import time
from functools import partial

import torch

from diffstack_mmv.data import ConvertedCache, read_rides
from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.geometry import direction
from diffstack_mmv.identification.measured import (
    EgoEstimator,
    MeasuredStudy,
    held_out_errors,
    measured_rides,
)
from diffstack_mmv.identification.measured.parts import FinishedParts
from diffstack_mmv.identification.measured.validation import folds_by, session_of
from diffstack_mmv.types import EgoMeasurement
from diffstack_mmv.vehicles import load_vehicle
from dmmv_conventions.versions import code_version

POSE, COASTING = 3, 2


def measurement(ride, step):
    """What is measured at the end of a step."""
    before = max(step - 1, 0)
    row = (ride.position[step], ride.known[step], ride.steer[before], ride.speed[before])
    return EgoMeasurement(*(part.unsqueeze(0) for part in (*row, ride.yaw_rate[before])))


def rolled(simulator, shared, estimate, window, driven):
    """Positions over the future of a window from an estimate at its start."""
    pose, moving = estimate.state[:, :POSE].clone(), estimate.motion
    ahead = simulator.lead_s * moving.velocity[:, :1] * direction(moving.heading)
    pose[:, :2] -= window.origin + ahead
    errors = pose.new_zeros(1, 2 * simulator.knots(window.steps))
    local = torch.cat([pose, estimate.instruments, driven, errors], -1)
    return simulator.simulate(window, shared, local).position


def errors_of_ride(estimator, ride, windows, history):
    """ADE of every window of a ride by the position at which its roll-out begins."""
    starts = {tuple(origin): index for index, origin in enumerate(windows.origin.tolist())}
    begins = [step for step, place in enumerate(ride.position.tolist()) if tuple(place) in starts]
    if not begins:  # a piece of the recording too short for a roll-out
        return {}
    driven = estimator.priors.freewheel(False)[0].unsqueeze(0)
    found, horizon = {}, estimator.init(measurement(ride, begins[0]))
    for step in range(begins[0] + 1, begins[-1] + history + 1):
        update = estimator(horizon, measurement(ride, step))
        horizon = update.horizon
        index = starts.get(tuple(ride.position[step - history].tolist()))
        if index is None:
            continue
        future = windows.select(torch.tensor([index])).tail(history)
        path = rolled(estimator.simulator, estimator.shared, update.estimate, future, driven)
        found[index] = float((path - future.position)[0, 1:].norm(dim=-1).mean())
    return found


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("cache")
    parser.add_argument("parts")
    parser.add_argument("--sessions", nargs="+", default=["09_06"])
    options = parser.parse_args()
    torch.set_num_threads(1)
    spec = load_vehicle("autobike")
    place = (ConvertedCache("autobike", options.cache), ["train", "val", "test"], spec.mode)
    rides = measured_rides(*read_rides(*place))
    study = MeasuredStudy(spec, parts=FinishedParts(options.parts).keyed(code_version()))
    model = partial(model_of, spec, "kbm", 0.1)
    windows, rollouts, fitted = study.whole(rides, "kbm", model)
    simulator, fit = fitted
    simulator, history = simulator.under(fit.noise), study.history_steps
    folds = folds_by(rollouts.names, sessions=False)
    named = [session_of(name) for name in rollouts.names]
    wanted = torch.tensor([name in options.sessions for name in named])[rollouts.recording]
    print("| roll-outs of 3 s from | ADE [m] without gyro | with gyro |\n|---|---|---|")
    rows = {"a history of 2 s": [], "`EgoEstimator`": []}
    for gyro in (False, True):
        errors = held_out_errors(simulator, fit, rollouts, history, folds, gyro)
        rows["a history of 2 s"].append(float(errors.ade[wanted].mean()))
        found, begin = [], time.process_time()
        for ride in rides:
            number = rollouts.names.index(ride.recording)
            if named[number] not in options.sessions:
                continue
            fold = folds[sorted(rollouts.names).index(ride.recording)]
            part = rollouts.select(rollouts.recording == number)
            print(ride.name, len(found), round(time.process_time() - begin), file=sys.stderr)
            shared, priors = fit.shared_without(fold), fit.instruments.priors(fold)
            estimator = EgoEstimator(simulator, shared, priors, history, gyro)
            found += errors_of_ride(estimator, ride, part, history).values()
        rows["`EgoEstimator`"].append(sum(found) / len(found))
    for name, values in rows.items():
        print(f"| {name} | {' | '.join(f'{value:.3f}' for value in values)} |")
    print(f"\n{len(found)} roll-outs; {time.process_time() - begin:.0f} s of one core for the last")


if __name__ == "__main__":
    main()
