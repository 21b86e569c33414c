"""Vehicle and instruments are found again in rides of a known vehicle, and the ego on them."""

import pytest
import torch

from diffstack_mmv.dynamics import DiffKBM
from diffstack_mmv.identification import ParameterVector
from diffstack_mmv.identification.inference import IdentifiabilityThresholds
from diffstack_mmv.identification.measured import (
    EgoEstimator,
    EgoMeasurement,
    InstrumentPriors,
    MeasuredFitter,
    MeasuredStudy,
    MeasurementNoise,
    RideSimulator,
    RideWindowSettings,
    cut_windows,
    measured_result,
    measured_tables,
    paired_by_recording,
)
from diffstack_mmv.identification.measured.synthetic import record_rides
from diffstack_mmv.identification.measured.validation import folds_by
from diffstack_mmv.vehicles import load_vehicle

SETTINGS = RideWindowSettings(jump_m=9.0)


def simulator_of(spec):
    model = DiffKBM(spec).double()
    return RideSimulator(model, ParameterVector(model, spec), MeasurementNoise(), spec)


@pytest.fixture(scope="module")
def recorded():
    spec = load_vehicle("autobike")
    simulator = simulator_of(spec)
    generator = torch.Generator().manual_seed(3)
    return spec, simulator, record_rides(simulator, InstrumentPriors(), 3, 110, generator)


@pytest.fixture(scope="module")
def fitted(recorded):
    spec, simulator, synthetic = recorded
    windows = cut_windows(synthetic.rides, SETTINGS)
    return windows, MeasuredFitter()(simulator, windows)


def test_wheelbase_and_offsets_are_within_their_intervals(recorded, fitted):
    _, simulator, synthetic = recorded
    _, fit = fitted
    vector = simulator.parameters
    error = vector.values(fit.point.shared[:1]) - vector.values(synthetic.shared[:1])
    assert abs(float(error)) < 3 * float(fit.shared_std[0]) < 0.3
    assert fit.converged
    per_curvature = simulator.steer_per_curvature
    apart = float(per_curvature(fit.point.shared) - per_curvature(synthetic.shared))
    assert abs(apart) < 4 * fit.std_of(per_curvature)
    apart = (fit.point.recording - synthetic.recording) / fit.recording_std
    assert float(apart.abs().max()) < 4
    assert float(fit.recording_std[:, 0].max()) < 0.02  # the prior has 0.05


def test_shared_unknowns_without_a_recording_are_those_of_a_fit_without_it(recorded, fitted):
    _, simulator, synthetic = recorded
    windows, fit = fitted
    (left_out, *_) = folds_by(windows.names, sessions=False)
    rest = [ride for ride in synthetic.rides if ride.recording != windows.names[0]]
    again = MeasuredFitter()(simulator, cut_windows(rest, SETTINGS))
    close = (fit.shared_without(left_out) - again.point.shared).abs() / again.shared_std
    assert float(close.max()) < 0.5


def test_windows_do_not_share_steps_and_skip_what_is_slow_or_bridged(recorded):
    _, _, synthetic = recorded
    (ride, *_) = synthetic.rides
    assert len(cut_windows([ride], SETTINGS).recording) <= 5
    slow = ride._replace(speed=torch.where(torch.arange(111) < 50, 0.5, ride.speed))
    bridged = ride._replace(known=torch.arange(111) < 50)
    for changed, most in ((slow, 4), (bridged, 2)):
        assert 0 < len(cut_windows([changed], SETTINGS).recording) <= most
    with pytest.raises(ValueError, match="rides"):
        cut_windows([ride._replace(speed=0 * ride.speed)], SETTINGS)


@pytest.mark.parametrize("with_gyro", [False, True])
def test_ego_estimate_finds_offset_and_place_from_the_past(recorded, with_gyro):
    _, simulator, synthetic = recorded
    estimator = EgoEstimator(simulator, synthetic.shared, steps=12, with_gyro=with_gyro)
    rides = synthetic.rides[:2]

    def at(step):
        return EgoMeasurement(
            torch.stack([ride.position[step] for ride in rides]),
            torch.stack([ride.known[step] for ride in rides]),
            torch.stack([ride.steer[max(step - 1, 0)] for ride in rides]),
            torch.stack([ride.speed[max(step - 1, 0)] for ride in rides]),
            torch.stack([ride.yaw_rate[max(step - 1, 0)] for ride in rides]),
        )

    horizon = estimator.init(at(0))
    for step in range(1, 15):
        update = estimator(horizon, at(step))
        horizon = update.horizon
    truth = torch.stack([synthetic.recording[0], synthetic.recording[1]])
    apart = (update.estimate.instruments - truth) / update.estimate.instruments_std
    assert float(apart[:, [0, 2]].abs().max()) < 4
    antenna = torch.stack([ride.position[14] for ride in rides])
    assert float((update.estimate.state[:, :2] - antenna).norm(dim=-1).max()) < 1.5
    assert update.estimate.state.isfinite().all()


def test_study_reports_the_keys_of_the_contract(recorded):
    spec, _, synthetic = recorded
    study = MeasuredStudy(spec, fitted=SETTINGS, noise_rounds=0)
    result = study(synthetic.rides, {"kbm": lambda: DiffKBM(spec)})
    content = measured_result(study, result, IdentifiabilityThresholds())
    assert content["heldout_after"] < content["heldout_before"]
    entry = content["parameters"]["wheelbase"]
    assert {"initial", "estimate", "low", "high", "unit", "std", "identifiability"} <= set(entry)
    assert entry["interval_95"][0] < entry["estimate"] < entry["interval_95"][1]
    assert len(measured_tables(content)["Roll-outs"]) > 5
    vehicle = result.calibrated(spec, "test")
    assert vehicle.wheelbase.initial == pytest.approx(entry["estimate"])


def test_paired_test_counts_recordings_not_windows():
    owner = torch.tensor([0, 0, 0, 1, 1])
    test = paired_by_recording(torch.zeros(5), torch.tensor([1.0, 1, 1, 2, 2]), owner)
    assert (test.mean, test.recordings, test.smaller) == (-1.5, 2, 2)
