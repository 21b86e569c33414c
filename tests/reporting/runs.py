"""Evaluated runs that never ran."""

import numpy as np
import pandas as pd

from diffstack_mmv.metrics import OPEN_LOOP
from diffstack_mmv.reporting import summarise_modes, write_metrics, write_parquet

SITUATIONS = ["moving", "standing"]


def samples(seed=0, shift=0.0):
    """Random scores of 60 samples, 40 of them bicycles."""
    rng = np.random.default_rng(seed)
    count = 60
    frame = pd.DataFrame({name: rng.random(count) + shift for name in OPEN_LOOP})
    frame["mode"] = np.where(np.arange(count) % 3 == 0, "scooter", "bicycle")
    frame["scene"] = [f"scene_{i // 4}" for i in range(count)]
    frame["agent"], frame["row"] = "ego", np.arange(count)
    frame["moving"] = np.arange(count) % 2 == 0
    frame["standing"] = False
    frame["stand_still/ade"], frame["stand_still/fde"] = 2.0, 4.0
    return frame


def write_run(folder, dynamics, seed, shift=0.0, frame=None, vehicle="bicycle", **more):
    """What `evaluate.py` writes for a run of that name."""
    frame = samples(seed, shift) if frame is None else frame
    header = {"goal": "predicted", "dynamics": dynamics, "vehicle": vehicle, "data": "thab_vru"}
    header |= {"split": "test", "seed": seed} | more
    told = summarise_modes(frame, SITUATIONS, vehicle, OPEN_LOOP)
    write_metrics(folder, header | told, OPEN_LOOP)
    write_parquet(folder / "samples.parquet", frame)
    return folder
