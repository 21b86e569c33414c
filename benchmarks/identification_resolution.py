"""How far apart models could be that follow recorded tracks: the tracks of a model that is known.

    python benchmarks/identification_resolution.py CACHE --truth gm3 kbm --seeds 3

Rides that explain the most exciting TH-AB cyclists are continuous by a model that then is the truth; positions every
0.08 s get the noise of the recording, are smoothed as a converter does, and followed by all models. The table goes to
benchmarks/results/identification_resolution.md.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from scipy.interpolate import CubicSpline

from data_converters.smoothing import ZeroPhaseSmoother
from diffstack_mmv.data import ConvertedCache, read_tracks, recorded_noise
from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.identification import (
    DataSplit,
    ExcitationSelection,
    IdentificationProblem,
    Identifier,
    ModelComparison,
    Recordings,
    SegmentSettings,
    TrackingSettings,
    TrackSegment,
    cut_tracks,
    estimate_rider_scales,
    split_segments,
)
from diffstack_mmv.vehicles import load_vehicle

TABLE = Path(__file__).parent / "results" / "identification_resolution.md"
DT_S, STEP_S = 0.1, 0.08
MODELS = ("gm3", "kbm", "unicycle")
IDENTIFIER = Identifier(starts=0)


def recorded_again(segment, position, noise, generator):
    """A segment of other positions, with noise and smoothed."""
    time_s = DT_S * np.arange(len(position))
    at_s = np.arange(0.0, time_s[-1] + 1e-9, STEP_S)
    way = CubicSpline(time_s, position)
    velocity = way(at_s, 1)
    along = velocity / np.linalg.norm(velocity, axis=1, keepdims=True)
    across = np.stack([-along[:, 1], along[:, 0]], 1)
    error = noise.along_m * generator.standard_normal((len(at_s), 1)) * along
    error += noise.across_m * generator.standard_normal((len(at_s), 1)) * across
    smooth = ZeroPhaseSmoother()(at_s, way(at_s) + error, time_s[time_s <= at_s[-1]])
    course = np.unwrap(np.arctan2(smooth.rate[:, 1], smooth.rate[:, 0]))
    speed = np.hypot(smooth.rate[:, 0], smooth.rate[:, 1])
    return TrackSegment(
        segment.name, *(torch.from_numpy(each) for each in (smooth.value, course, speed))
    )


def errors(spec, settings, segments, origin):
    """One row per model."""
    study = ModelComparison(spec, DataSplit(segments[:2], segments), settings, IDENTIFIER)
    rows = []
    for name in MODELS:
        heldout = study(lambda name=name: model_of(spec, name, DT_S)).validation
        rows.append({"tracks": origin, "model": name, **heldout.pooled()})
    return rows


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("cache", help="folder of the trajdata cache of thab_vru")
    parser.add_argument("--truth", nargs="+", default=["gm3", "kbm"], choices=MODELS)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--segments", type=int, default=40)
    options = parser.parse_args()
    source, spec = ConvertedCache("thab_vru", options.cache), load_vehicle("bicycle")
    tracks = read_tracks(source, ("train", "val"), "bicycle")
    chosen = split_segments(
        cut_tracks(Recordings(tracks), SegmentSettings()),
        ExcitationSelection(),
        options.segments,
        1,
        0,
    ).fitted
    step, noise = (recorded_noise(source, "bicycle", step_s) for step_s in (DT_S, STEP_S))
    if step is None or noise is None:
        parser.error("the cache holds no cyclists")
    settings = estimate_rider_scales(TrackingSettings(**step._asdict()), spec, chosen, DT_S)
    rows = errors(spec, settings, chosen, "recorded")
    for truth in options.truth:
        problem = IdentificationProblem.of(
            model_of(spec, truth, DT_S), spec, DataSplit(chosen, chosen[:1]), settings
        )
        rides = problem.fitted_motions(IDENTIFIER(problem.simulator, problem.data))
        for seed in range(options.seeds):
            generator = np.random.default_rng(seed)
            again = [
                recorded_again(ride.segment, ride.position.numpy(), noise, generator)
                for ride in rides
            ]
            rows += errors(spec, settings, again, f"simulated by {truth}")
    table = pd.DataFrame(rows).groupby(["tracks", "model"], sort=False).mean().reset_index()
    TABLE.write_text(table.to_markdown(index=False, floatfmt=".4f") + "\n")


if __name__ == "__main__":
    main()
