"""What is written about an identification."""

import json
from dataclasses import asdict

import pytest
import torch

from diffstack_mmv.identification import (
    Explained,
    Identifier,
    Stretch,
    Thresholds,
    TrackingSettings,
    beyond_limits,
    held_out,
    lean_agreement,
    losses,
    summarise,
)
from diffstack_mmv.identification.nested import Nested
from diffstack_mmv.plotting import FittedTrack, save_identification
from diffstack_mmv.reporting import write_identification
from diffstack_mmv.vehicles import load_vehicle, save_vehicle
from tests.identification.conftest import LIVELY, synthetic_case

CONTRACT = {"tracks", "loss_before", "loss_after", "heldout_before", "heldout_after", "parameters"}
ENTRY = {"initial", "estimate", "low", "high", "unit", "std", "identifiability"}
FIGURES = {"tracks.png", "controls.png", "parameters.png", "spectrum.png", "profiles.png"}
HEADER = {"vehicle": "bicycle", "dynamics": "kbm", "data": "toy", "mode": "shooting", "seed": 0}


@pytest.fixture(scope="module")
def result():
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    case = synthetic_case("kbm", {"wheelbase": 1.15})
    found = Identifier(starts=0)(case.tracker, case.data)
    torch.set_default_dtype(before)
    return case, found, summarise(case.tracker, case.data, found, Thresholds())


def test_summary_holds_the_keys_that_others_rely_on(result):
    summary = result[2]
    assert set(summary) >= CONTRACT
    assert set(summary["parameters"]["wheelbase"]) >= ENTRY
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary


def test_report_tells_parameters_models_and_remarks(result, tmp_path):
    case, found, summary = result
    models = {"kbm": losses(case.tracker, case.data, found)}
    write_identification(tmp_path, HEADER | summary | {"models": models})
    text = (tmp_path / "identification.md").read_text()
    assert "wheelbase" in text
    assert "identifiable" in text
    assert "Influence of the regularisation" in text
    assert json.loads((tmp_path / "identification.json").read_text())["seed"] == 0


def test_figures_are_drawn(result, tmp_path):
    case, found, summary = result
    tracks = [
        FittedTrack("a", r.stretch.position.numpy(), r.position.numpy(), r.controls.numpy())
        for r in case.explained(found)
    ]
    shown = summary | {"profiles": {"wheelbase": {"values": [1.0, 1.1], "costs": [3.0, 1.0]}}}
    save_identification(tmp_path, shown, tracks, ("acceleration", "steer"), 0.1)
    drawn = {path.name for path in tmp_path.glob("*.png")}
    assert drawn == {
        f"{n}.png" for n in ["tracks", "controls", "parameters", "spectrum", "profiles"]
    }


def test_calibrated_vehicle_is_a_vehicle_again(result, tmp_path):
    case, found, summary = result
    spec = load_vehicle("bicycle")
    save_vehicle(case.calibrated(spec, found, "a test"), tmp_path / "v.yaml", {"tracks": 3})
    again = load_vehicle(tmp_path / "v.yaml")
    estimate = summary["parameters"]["wheelbase"]["estimate"]
    assert again.wheelbase.initial == pytest.approx(estimate, rel=1e-9)
    assert again.provenance["tracks"] == 3
    assert again.parameters == spec.parameters


def test_explanations_follow_the_tracks(result):
    case, found, _ = result
    for row in case.explained(found):
        assert row.position.shape == row.stretch.position.shape
        assert len(row.controls) == len(row.position) - 1
        assert float((row.position - row.stretch.position).norm(dim=-1).max()) < 0.15


def leaning(model, measured):
    time = torch.arange(len(measured)).double()
    line = torch.stack([time, time], -1)
    stretch = Stretch("a@0.0s", line, time, time, None, measured)
    return Explained(stretch, line, line[1:], model)


def test_lean_agreement_leaves_out_what_was_not_measured():
    model = torch.tensor([0.1, 0.2, 0.3, 0.4])
    measured = torch.tensor([torch.nan, 0.1, 0.2, 0.3])
    told = lean_agreement([leaning(model, measured)], 0.1, 0.1)
    assert told["samples"] == 3
    assert told["rms_difference_rad"] == pytest.approx(0.1)
    assert told["correlation"] == pytest.approx(1.0)
    assert lean_agreement([leaning(None, measured)], 0.1) is None


@pytest.mark.parametrize("late", [0, 3, 7])
def test_a_late_lean_is_told_by_how_much(late):
    time_s = 0.1 * torch.arange(80).double()
    wave = torch.sin(2.0 * time_s) + torch.sin(0.7 * time_s)
    told = lean_agreement([leaning(wave.roll(late), wave)] * 2, 0.1)
    assert told["late_s"] == pytest.approx(0.1 * late)
    assert told["correlation_late"] > 0.99


def test_harder_riding_than_the_limits_allow_is_counted(bicycle):
    time_s = 0.1 * torch.arange(41).double()
    speed = 2.0 + torch.cat([torch.zeros(21), 8.0 * time_s[:20]]).double()
    hard = leaning(None, time_s).stretch._replace(speed=speed)
    assert 0.4 < beyond_limits([hard], bicycle.limits, 0.1) < 0.55
    assert beyond_limits([hard._replace(speed=time_s)], bicycle.limits, 0.1) == 0.0


def test_report_tells_what_was_assumed_and_what_was_held_out(result, tmp_path):
    case, found, summary = result
    models = {"kbm": losses(case.tracker, case.data, found)}
    heldout = held_out(case, found, Identifier(), 5)
    judged = {"kbm": heldout.pooled() | heldout.change_from(heldout)}
    extra = {
        "models": models,
        "assumed": asdict(TrackingSettings()),
        "beyond_limits": 0.07,
        "validation": {"folds": 4, "stretches": 1, "foresee_s": 0.5, "models": judged},
        "lean": lean_agreement([leaning(torch.rand(30), torch.rand(30))], 0.1),
    }
    write_identification(tmp_path, HEADER | summary | extra)
    text = (tmp_path / "identification.md").read_text()
    for part in ("In 7 % of the samples", "each held out once in 4 folds", "3.00 m/s³", "s late"):
        assert part in text


def test_free_steering_is_named_as_the_reason():
    case = synthetic_case("kbm", {}, known=False, manoeuvres=LIVELY[:1])
    found = Identifier(starts=0)(case.tracker, case.data)
    remarks = summarise(case.tracker, case.data, found, Thresholds())["remarks"]
    assert any("wheelbase is not observable" in each and "free" in each for each in remarks)


def test_estimate_that_hangs_on_the_steering_prior_is_not_to_be_trusted():
    case = synthetic_case("kbm", {}, False, LIVELY * 3, steer_rate_radps=0.1)
    found = Identifier(thresholds=Thresholds(informed=1.0), starts=0)(case.tracker, case.data)
    remarks = summarise(case.tracker, case.data, found, Thresholds())["remarks"]
    assert any("`steer_rate_radps`" in each and "Do not trust it" in each for each in remarks)
    assert any("edge of its range" in each for each in remarks)


def test_model_without_parameters_only_follows_tracks():
    case = synthetic_case("unicycle", {}, known=False, manoeuvres=LIVELY[:1])
    found = Identifier(Nested())(case.tracker, case.data)
    summary = summarise(case.tracker, case.data, found, Thresholds())
    assert summary["parameters"] == {}
    assert summary["loss_before"] == summary["loss_after"]
