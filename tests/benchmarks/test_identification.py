"""Benchmarks of the identification do their work on short rides."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

pytestmark = pytest.mark.usefixtures("precise")


@pytest.fixture
def slalom(script):
    """A recorded slalom of a unicycle."""
    recovery = script("identification_recovery")
    spec = recovery.load_vehicle("bicycle")
    model = recovery.model_of(spec, "unicycle", recovery.STEP_S).double()
    measurement = recovery.MeasurementModel(recovery.NOISE_M, recovery.CONTROL_NOISE, 1)
    given = model, spec, recovery.QUICK[:1], measurement, torch.Generator().manual_seed(0)
    return recovery.record_manoeuvres(*given)[0]


@pytest.mark.parametrize("smoother", ["none", "causal", "zero_phase"])
def test_a_smoothed_segment_keeps_its_fields_together(script, slalom, smoother):
    recovery = script("identification_recovery")
    found = recovery.smoothed(slalom, recovery.SMOOTHERS[smoother])
    count = len(found.position)
    assert {len(found.course), len(found.speed), len(found.controls)} == {count}
    assert count > 0.75 * len(slalom.position)
    start = int((slalom.course == found.course[0]).nonzero()[0])
    same = slice(start, start + count)
    torch.testing.assert_close(found.speed, slalom.speed[same], rtol=0, atol=0)
    torch.testing.assert_close(found.position, slalom.position[same], rtol=0, atol=0.2)


def test_a_seed_of_the_recovery_is_written(script, monkeypatch, tmp_path):
    recovery, rows = script("identification_recovery"), tmp_path / "rows.jsonl"
    fit = recovery.LevenbergMarquardt
    for name, value in (
        ("ROWS", rows),
        ("TABLE", tmp_path / "table.md"),
        ("MANOEUVRES", {"quick": recovery.QUICK[3:]}),
        ("LevenbergMarquardt", lambda iterations: fit(1)),
    ):
        monkeypatch.setattr(recovery, name, value)
    told = "kbm --smoother causal --manoeuvres quick --repeats 1 --starts 0 --seeds 1 --own-steps"
    monkeypatch.setattr("sys.argv", ["recovery.py", *told.split(), "--table"])
    recovery.main()
    assert len(rows.read_text().splitlines()) > 0
    assert "wheelbase" in (tmp_path / "table.md").read_text()


def test_a_seed_of_the_measured_recovery(script):
    errors, own, _ = script("identification_measured_recovery").recover("kbm", 0, 1, 60)
    assert {"wheelbase", "steer_per_curvature"} <= set(errors)
    assert own.isfinite().all()


def test_tracks_recorded_again_are_compared(script, slalom, monkeypatch):
    resolution = script("identification_resolution")
    noise = SimpleNamespace(along_m=0.02, across_m=0.02)
    plain = slalom._replace(controls=None)
    again = [
        resolution.recorded_again(plain, plain.position.numpy(), noise, generator)
        for generator in map(np.random.default_rng, (0, 1))
    ]
    monkeypatch.setattr(resolution, "MODELS", ("unicycle",))
    settings = resolution.TrackingSettings(0.02, 0.02, 20.0, 2.0)
    spec = resolution.load_vehicle("bicycle")
    [row] = resolution.errors(spec, settings, again, "here")
    assert row["followed"] < 0.02


def test_laws_of_lean_are_told_and_drawn(script, tmp_path, capsys):
    torch.set_default_dtype(torch.float32)
    lean, wave = script("lean_laws"), torch.sin(torch.arange(40.0) / 5)
    rows = [("bicycle", wave, wave / 9.81), ("scooter", 0.5 * wave, wave / 20)]
    own = {name: lean.prescribed(lean.load_vehicle(name)) for name in ("bicycle", "scooter")}
    shown = lean.table(rows, False, own, 3.0)
    lean.draw(shown, tmp_path / "lean.png")
    assert "| bicycle | coordinated, best there is |" in capsys.readouterr().out
    assert (tmp_path / "lean.png").is_file()


def test_an_ego_is_estimated_through_a_ride(script):
    ego, measured = script("ego_estimator"), script("identification_measured_recovery")
    spec, priors = measured.load_vehicle("autobike"), measured.InstrumentPriors()
    model = measured.model_of(spec, "kbm", 0.1).double()
    vector = measured.ParameterVector(model, spec)
    simulator = measured.RideSimulator(model, vector, measured.REAL, spec)
    generator = torch.Generator().manual_seed(0)
    made = measured.record_rides(simulator, priors, 1, 60, generator)
    windows = measured.cut_windows(made.rides, measured.RideWindowSettings(jump_m=9.0))
    estimator = ego.EgoEstimator(simulator, made.shared, priors, 5)
    [error] = ego.errors_of_ride(
        estimator, made.rides[0], windows.select(torch.tensor([0])), 5
    ).values()
    assert error < 1.0
