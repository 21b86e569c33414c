"""Folders as the commands leave them, without the work."""

import numpy as np
import pandas as pd

from diffstack_mmv.metrics import CLOSED_LOOP, OPEN_LOOP
from diffstack_mmv.plotting import save_figure
from diffstack_mmv.plotting.figures import new_figure
from diffstack_mmv.reporting import write_compact, write_json
from diffstack_mmv.reporting.html import HORIZON_FILE, SCENES_FILE, Titles, horizon_content
from tests.reporting.runs import write_run

TITLES = Titles(OPEN_LOOP, CLOSED_LOOP)


def forecast(steps, components, offset=0.0):
    """A forecast straight ahead, more uncertain with time."""
    mean = [[[0.1 * step, offset + k] for step in range(steps)] for k in range(components)]
    spread = [[[0.1 + 0.01 * step, 0.02, 0.1] for step in range(steps)]] * components
    return {"weight": [1 / components] * components, "mean": mean, "covariance": spread}


def scene(steps=6, history=4):
    """A record of scenes.json with one neighbor, seen now and then."""
    past = [[0.1 * step, 0.0, 0.0] for step in range(1 - history, 1)]
    future = [[0.1 * step, 0.01 * step, 0.0] for step in range(1, steps + 1)]
    ego = {"mode": "bicycle", "extent": [1.8, 0.6], "past": past, "future": future}
    seen = [None, *past[1:]]
    neighbor = {"mode": "pedestrian", "extent": [0.5, 0.5], "past": seen, "future": [None] * steps}
    plan = [[0.12 * step, 0.0, 0.0] for step in range(steps + 1)]
    return {
        "title": "bicycle, median plan ADE",
        "dt_s": 0.1,
        "goal": [0.7, 0.1],
        "ego": ego,
        "plan": plan,
        "candidates": [[[0.1 * step, side] for step in range(steps + 1)] for side in (-0.2, 0.2)],
        "prediction": forecast(steps, 2),
        "neighbors": [neighbor | {"prediction": forecast(steps, 1, 2.0)}],
    }


def evaluation(folder):
    """What `evaluate` writes, with everything a page can show of it."""
    write_run(folder, "kbm", 0)
    errors = {"bicycle": {"plan": np.linspace(0.1, 1, 6), "kalman": np.full(6, np.nan)}}
    write_compact(folder / HORIZON_FILE, horizon_content(errors, 0.1, "error [m]"))
    write_compact(folder / SCENES_FILE, {"scenes": [scene(), scene()]})
    save_figure(new_figure(1, 1), folder / "plans_bicycle.png")
    return folder


def training(folder):
    """The CSV log of a training of two epochs."""
    (folder / "csv").mkdir(parents=True)
    rows = {
        "epoch": [0, 0, 1, 1],
        "train/loss": [3.0, None, 2.0, None],
        "val/plan_ade": [None, 1.0, None, 0.9],
        "val/bicycle/plan_ade": [None, 1.0, None, 0.9],
        "cost_weight/effort": [0.1, None, 0.2, None],
        "physical/wheelbase": [1.0, None, 1.1, None],
    }
    pd.DataFrame(rows).to_csv(folder / "csv" / "metrics.csv", index=False)
    return folder


def drive(folder, thoughts=True):
    """What `navigate` writes of two cases with three pedestrians."""
    cases = [
        {"case": 0, "outcome": "success", "time_s": 1.0, "steps": 4, "min_clearance_m": 0.5}
        | {"discomfort_steps": 0},
        {"case": 1, "outcome": "collision", "time_s": 0.75, "steps": 3, "min_clearance_m": -0.1}
        | {"discomfort_steps": 1},
    ]
    numbers = dict.fromkeys(CLOSED_LOOP, 0.5)
    intervals = {f"{name}_ci95": [0.1, 0.9] for name in ("success_rate", "collision_rate")}
    model = {"footprint": {"shape": "box", "length_m": 1.8, "width_m": 0.6}, "controls": ["a", "b"]}
    told = {"vehicle": "bicycle", "dynamics": "kbm", "controller": "diffmpc", "dt_s": 0.25, "n": 2}
    content = told | numbers | intervals | {"actual_model": model, "cases": cases}
    write_json(folder / "closed_loop.json", content)
    (folder / "config.yaml").write_text("scenario: {circle_radius_m: 4.0}\n")
    rng = np.random.default_rng(0)
    place = folder / "episodes" / "diffmpc"
    place.mkdir(parents=True)
    arrays = {
        "cases": [0, 1],
        "steps": [4, 3],
        "motion.position": rng.random((2, 5, 2)),
        "motion.heading": rng.random((2, 5)),
        "motion.velocity": rng.random((2, 5, 2)),
        "pedestrians": rng.random((2, 5, 3, 2)),
        "controls": rng.random((2, 4, 2)),
        "clearance": rng.random((2, 5)),
    }
    if thoughts:
        arrays["thoughts.plan"] = rng.random((2, 4, 7, 2)).astype(np.float16)
        arrays["thoughts.forecast"] = np.full((2, 4, 3, 6, 5), 0.1, np.float16)
    np.savez(place / "test_00000-00001.npz", **arrays)
    return folder


def identification(folder):
    """What `identify` writes, the numbers alone."""
    entry = {"initial": 1.0, "estimate": 1.1, "low": 0.5, "high": 2.0, "unit": "m", "std": 0.1}
    entry |= {"prior_std": 0.2, "identifiability": 0.5, "verdict": "identifiable"}
    profile = {"values": [1.0, 1.1, 1.2], "costs": [3.0, 1.0, 2.0]}
    content = {"vehicle": "bicycle", "models": {"kbm": {"loss_before": 0.1, "loss_after": 0.05}}}
    content |= {"parameters": {"wheelbase": entry}, "combinations": {}, "profiles": {"w": profile}}
    influence = {"jerk_mps3": {"wheelbase": 0.1}}
    content |= {"remarks": ["a < b & c"], "regularisation_influence": influence}
    write_json(folder / "identification.json", content)
    return folder


def comparison(folder):
    """What `compare` writes; a single run has no test."""
    folder.mkdir()
    (folder / "table.csv").write_text("mode,dynamics,ADE [m]\nbicycle,kbm,0.5 ± 0.1\n")
    (folder / "tests.csv").write_text("\n")
    return folder


def simulation(folder):
    """What `simulate` writes for two models."""
    folder.mkdir()
    for name in ("kbm", "gm3"):
        (folder / f"trajectory_{name}.csv").write_text("time_s,px,steer\n0.0,0.0,0.1\n0.1,1.0,\n")
    return folder


KINDS = (evaluation, training, drive, identification, comparison, simulation)
