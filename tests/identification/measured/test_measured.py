"""Vehicle and instruments are found again in rides of a known vehicle, and the ego on them."""

import json
from dataclasses import replace
from functools import partial

import pytest
import torch

from diffstack_mmv.dynamics import DiffKBM, SoftplusFloor
from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.geometry import direction
from diffstack_mmv.identification import ParameterVector
from diffstack_mmv.identification.inference import IdentifiabilityThresholds
from diffstack_mmv.identification.measured import (
    EgoEstimator,
    InstrumentPriors,
    MeasuredFitter,
    MeasuredStudy,
    MeasuredStudyResult,
    MeasurementNoise,
    RideSimulator,
    RideWindowSettings,
    cut_windows,
    measured_remarks,
    measured_result,
    measured_tables,
    paired_by_recording,
)
from diffstack_mmv.identification.measured.elimination import RideEquations
from diffstack_mmv.identification.measured.parts import FinishedParts
from diffstack_mmv.identification.measured.stages import HeldOut, Judging
from diffstack_mmv.identification.measured.study import ModelFit
from diffstack_mmv.identification.measured.synthetic import record_rides
from diffstack_mmv.identification.measured.validation import (
    RolloutErrors,
    folds_by,
    session_of,
)
from diffstack_mmv.identification.measured.vehicle import at_ends
from diffstack_mmv.identification.measured.volume import volume_slopes
from diffstack_mmv.types import EgoMeasurement
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
    assert abs(float(error)) < 2 * float(fit.shared_std[0]) < 0.3
    assert fit.converged
    per_curvature = simulator.steer_per_curvature
    apart = float(per_curvature(fit.point.shared) - per_curvature(synthetic.shared))
    assert abs(apart) < 2 * fit.std_of(per_curvature)
    apart = (fit.point.recording - synthetic.recording) / fit.recording_std
    assert float(apart.abs().max()) < 3
    assert float(fit.recording_std[:, 0].max()) < 0.02  # the prior has 0.05


def test_shared_unknowns_without_a_recording_are_those_of_a_fit_without_it(recorded, fitted):
    _, simulator, synthetic = recorded
    windows, fit = fitted
    (left_out, *_) = folds_by(windows.names, sessions=False)
    rest = [ride for ride in synthetic.rides if ride.recording != windows.names[0]]
    again = MeasuredFitter()(simulator, cut_windows(rest, SETTINGS))
    close = (fit.shared_without(left_out) - again.point.shared).abs() / again.shared_std
    assert float(close.max()) < 0.5


def test_shared_unknowns_maximise_the_evidence_and_not_the_joint_density(recorded, fitted):
    _, simulator, _ = recorded
    windows, fit = fitted
    joint = MeasuredFitter()(simulator, windows, fit.point, torch.zeros_like(fit.tilt))
    assert float(fit.tilt.sum(0).abs().max()) > 0.1
    assert joint.log_evidence < fit.log_evidence


def test_noise_and_bias_of_the_gyro_are_heard_in_the_residuals(recorded, fitted):
    _, simulator, _ = recorded
    _, fit = fitted
    given = simulator.noise
    assert fit.noise.yaw_rate_radps == pytest.approx(given.yaw_rate_radps, rel=0.15)
    assert (
        abs(fit.noise.yaw_rate_bias.mean - given.yaw_rate_bias.mean) < 2 * given.yaw_rate_bias.std
    )
    assert fit.noise.across_m == given.across_m


def test_what_is_left_of_the_newton_step_is_not_taken_for_a_slope_of_the_volume(recorded, fitted):
    _, simulator, _ = recorded
    windows, fit = fitted
    equations = RideEquations(simulator, windows, InstrumentPriors(), False, fit.point)
    off = fit.point.window + 1e-3 * torch.ones_like(fit.point.window)
    ended, early = (
        volume_slopes(equations, equations.linearised(point)).sum(0)
        for point in (fit.point, fit.point._replace(window=off))
    )
    torch.testing.assert_close(early, ended, rtol=0.1, atol=0.5)


def test_windows_may_have_a_vehicle_each(recorded, fitted):
    _, simulator, _ = recorded
    windows, fit = fitted
    two, local = windows.select(torch.arange(2)), fit.point.local(windows.recording)[:2]
    first = fit.point.shared
    both = torch.stack([first, first + 0.05])
    found = simulator.linearise(two, both, local, by_shared=False)
    for number, shared in enumerate(both):
        alone = simulator.linearise(two, shared, local, by_shared=False)
        torch.testing.assert_close(found.outputs[number], alone.outputs[number])
        torch.testing.assert_close(found.local[number], alone.local[number])


def test_lean_at_the_ends_of_a_window_is_neither_late_nor_early():
    means = torch.arange(5.0).unsqueeze(0) + 0.5  # of what is t at the time t
    torch.testing.assert_close(at_ends(means), torch.arange(6.0).unsqueeze(0))


def test_windows_do_not_share_steps_and_skip_what_is_slow_or_bridged(recorded):
    _, _, synthetic = recorded
    (ride, *_) = synthetic.rides
    assert len(cut_windows([ride], SETTINGS).recording) <= 5
    origin = cut_windows([ride], SETTINGS).origin
    ends = cut_windows([ride], SETTINGS).position[:, -1] + origin
    assert float((origin[1:] - ends[:-1]).norm(dim=-1).min()) > 0  # no position counts twice
    slow = ride._replace(speed=torch.where(torch.arange(111) < 50, 0.5, ride.speed))
    bridged = ride._replace(known=torch.arange(111) < 50)
    for changed, most in ((slow, 4), (bridged, 2)):
        assert 0 < len(cut_windows([changed], SETTINGS).recording) <= most
    with pytest.raises(ValueError, match="`rides` must .* change `speed_min_mps`; .*`jump_m`"):
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
    place, along = update.estimate.motion.position, direction(update.estimate.motion.heading)
    behind = ((antenna - place) * along).sum(-1)  # of the antenna, whose place is known
    torch.testing.assert_close(behind, synthetic.shared[-3].expand(2), rtol=0, atol=0.05)
    assert float((antenna - place).norm(dim=-1).max()) < 1.5
    assert update.estimate.state.isfinite().all()


def test_study_reports_the_keys_of_the_contract_and_goes_on_where_it_was(recorded, tmp_path):
    spec, _, synthetic = recorded
    parts = FinishedParts(tmp_path)
    study = MeasuredStudy(spec, fitted=SETTINGS, noise_rounds=0, parts=parts)
    models = {"kbm": lambda: DiffKBM(spec)}
    result = study(synthetic.rides, models)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    again = study(synthetic.rides, models)
    assert kept == {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert again.seconds == result.seconds
    torch.testing.assert_close(
        again.models["kbm"].fit.laplace_std, result.models["kbm"].fit.laplace_std
    )
    content = measured_result(study, result, IdentifiabilityThresholds())
    assert content["heldout_after"] < content["heldout_before"]
    entry = content["parameters"]["wheelbase"]
    assert {"initial", "estimate", "low", "high", "unit", "std", "identifiability"} <= set(entry)
    assert entry["interval_95"][0] < entry["estimate"] < entry["interval_95"][1]
    tables = measured_tables(content)
    assert len(tables["Roll-outs"]) > 5
    recordings = {row["recording"]: row for row in tables["Recordings"]}
    assert set(recordings) == {ride.recording for ride in synthetic.rides}
    assert {"steer_offset", "steer_scale", "speed_scale", "delay_s"} <= set(tables["Recordings"][0])
    # all rides are of one session, so that none can be left out
    assert len({session_of(ride.recording) for ride in synthetic.rides}) == 1
    told = json.dumps(content["rollouts"], allow_nan=False)
    assert "recording left out" in told
    assert "session left out" not in told
    assert "with gyro" in told
    deaf = result.rollouts._replace(yaw_rate=torch.full_like(result.rollouts.yaw_rate, torch.nan))
    content = measured_result(study, result._replace(rollouts=deaf), IdentifiabilityThresholds())
    told = json.dumps([content["rollouts"], content["tests"]])
    assert "recording left out" in told
    assert "with gyro" not in told
    vehicle = result.calibrated(spec, "test")
    assert vehicle.wheelbase.initial == pytest.approx(entry["estimate"])


def test_parts_of_other_data_code_or_another_reference_are_not_found_again(recorded):
    spec, _, synthetic = recorded
    study = MeasuredStudy(spec, fitted=SETTINGS)
    windows = cut_windows(synthetic.rides, SETTINGS)

    def key(reference="kbm", parts=study.parts, **changed):
        other = replace(study, parts=parts)
        return other._fitting(windows._replace(**changed), windows, reference).parts.key

    assert key() == key()
    others = [key(**{name: -getattr(windows, name)}) for name in ("course", "steer_rate", "speed")]
    others += [key("gm3"), key(known=~windows.known), key(parts=study.parts.keyed("code"))]
    assert len({key(), *others}) == 7


def test_parts_of_another_model_of_the_same_name_are_not_found_again(recorded, tmp_path):
    spec, _, synthetic = recorded
    fitter, parts = MeasuredFitter(iterations=1), FinishedParts(tmp_path)
    study = MeasuredStudy(spec, fitter, fitted=SETTINGS, noise_rounds=0, parts=parts)
    counts = []
    for floor in (None, None, SoftplusFloor(0.05)):
        model = partial(DiffKBM, spec, floor=floor)
        windows, rollouts, fitted = study.whole(synthetic.rides[:1], "kbm", model)
        judging = Judging(study._fitting(windows, rollouts, "kbm"), rollouts, 20)
        unknown = RolloutErrors.unknown(rollouts)
        judging._judged("all", "kbm", fitted, lambda *_, found=unknown: found, None)
        counts.append(len(list(tmp_path.iterdir())))
    assert counts == [2, 2, 4]  # a fit and its errors


def test_paired_test_counts_recordings_not_windows():
    owner = torch.tensor([0, 0, 0, 1, 1])
    test = paired_by_recording(torch.zeros(5), torch.tensor([1.0, 1, 1, 2, 2]), owner)
    assert (test.mean, test.recordings, test.smaller) == (-1.5, 2, 2)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"noise_rounds": -1}, "`noise_rounds` must be at least 0"),
        ({"horizon_s": 0.0}, "`horizon_s` must be at least 0.1"),
    ],
)
def test_a_measured_study_that_cannot_be_is_refused(given, told):
    with pytest.raises(ValueError, match=told):
        MeasuredStudy(load_vehicle("autobike"), **given)


def test_a_measured_model_needs_a_steering_angle():
    spec = load_vehicle("autobike")
    study = MeasuredStudy(spec)
    build = partial(model_of, spec, dt_s=0.1)
    study.require_models({name: partial(build, name) for name in ("gm3", "kbm", "unicycle")})
    with pytest.raises(ValueError, match="`dynamics` must be steered by an angle, but got Holonom"):
        study.require_models({"holonomic": partial(build, "holonomic")})


@pytest.mark.parametrize("longer", [1.0, 1.6])
def test_a_vehicle_beyond_the_range_of_its_file_is_remarked(recorded, longer):
    spec, _, synthetic = recorded
    rides = [ride._replace(steer=longer * ride.steer) for ride in synthetic.rides]
    study = MeasuredStudy(spec, fitted=SETTINGS, noise_rounds=0)
    windows, rollouts, fitted = study.whole(rides, "kbm", partial(DiffKBM, spec))
    nothing = RolloutErrors.unknown(rollouts)
    found = {"kbm": ModelFit(*fitted, HeldOut(nothing, nothing), HeldOut(nothing, nothing))}
    noise, priors = fitted.simulator.noise, InstrumentPriors()
    result = MeasuredStudyResult(windows, rollouts, found, {}, noise, priors, {})
    remarks = measured_remarks(result)
    told = ["wheelbase lies at the edge", "steer_gain lies"] if longer > 1 else []
    assert len(remarks) == len(told)
    assert all(part in remark for part, remark in zip(told, remarks, strict=True))
