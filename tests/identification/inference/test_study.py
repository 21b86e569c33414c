"""From recordings to identified and compared models."""

import math
from functools import partial

import pytest
import torch

from diffstack_mmv.dynamics import DiffKBM
from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.identification import (
    ExcitationSelection,
    IdentificationStudy,
    Identifier,
    LongestSelection,
    Recordings,
    SegmentSettings,
    TrackingAssumptions,
    identification_result,
    vehicle_provenance,
)
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import load_vehicle
from tests.identification.conftest import double_precision

WHEELBASE_M, SPEED_MPS = 1.1, 5.0
NOISE = {"acceleration": 0.1, "steer": 0.002}
RIDER = {"jerk_mps3": 2.0, "curvature_rate": 0.4}


def circle(yaw_rate, steps=60):
    """A motion along a circle."""
    time_s = 0.1 * torch.arange(steps + 1)
    heading = yaw_rate * time_s
    position = torch.stack([heading.sin(), 1 - heading.cos()], -1) * SPEED_MPS / yaw_rate
    velocity = torch.tensor([SPEED_MPS, 0.0]).expand(steps + 1, 2)
    return Motion(position, heading, velocity, torch.full_like(time_s, yaw_rate))


def recordings(turns=(0.3, -0.4, 0.5, -0.6)):
    """Circles with the steering of a bicycle that is known."""
    motions = {f"rider_{index}": circle(turn) for index, turn in enumerate(turns)}
    controls = {
        name: torch.tensor([0.0, math.atan(WHEELBASE_M * float(motion.yaw_rate[0]) / SPEED_MPS)])
        .expand(len(motion.heading), 2)
        for name, motion in motions.items()
    }  # fmt: skip
    return Recordings(motions, controls=controls, noise_m=(0.02, 0.02), smoother="none")


def study(**options):
    parts = {"segments": SegmentSettings(max_s=4.0), "selection": LongestSelection()}
    return IdentificationStudy(
        load_vehicle("bicycle"),
        TrackingAssumptions(**RIDER, controls=options.pop("controls", NOISE)),
        Identifier(starts=0),
        **{"tracks": 3, "heldout": 1} | parts | options,
    )


def builders(*names):
    return {name: partial(model_of, load_vehicle("bicycle"), name, 0.1) for name in names}


@pytest.fixture(scope="module")
def finished():
    with double_precision():
        whole = study(profile=["wheelbase"])
        return whole, whole(recordings(), builders("kbm", "kbm_smooth", "unicycle"))


def test_wheelbase_is_found_from_recorded_controls(finished):
    parameters = identification_result(finished[0], recordings(), finished[1])["parameters"]
    assert parameters["wheelbase"]["estimate"] == pytest.approx(WHEELBASE_M, rel=0.01)
    assert parameters["wheelbase"]["verdict"] == "identifiable"


def test_only_models_with_the_recorded_controls_are_compared(finished):
    assert list(finished[1].models) == ["kbm", "kbm_smooth"]


def test_result_tells_all_models_and_assumptions(finished):
    content = identification_result(finished[0], recordings(), finished[1])
    names = {"kbm", "kbm_smooth"}
    assert set(content["models"]) == set(content["validation"]["models"]) == names
    assert content["assumed"]["control_noise"] == (0.1, 0.002)
    assert set(content["profiles"]) == {"wheelbase"}
    assert (content["tracks"], content["heldout_tracks"]) == (3, 1)


@pytest.mark.parametrize(
    ("smoother", "controls", "done"),
    [
        ("CausalSmoother, looks 0 s ahead", True, "the lag of the smoother was undone"),
        ("CausalSmoother, looks 0 s ahead", False, "Convert with smoother=zero_phase"),
        ("ZeroPhaseSmoother, looks 0.45 s ahead", False, None),
        ("ZeroPhaseSmoother, looks 0.45 s ahead", True, "controls by the same filter"),
        ("Unsmoothed, looks 0 s ahead", True, None),
        ("none, tracks as trajdata reads them", True, None),
    ],
)
def test_smoothed_positions_are_remarked(finished, smoother, controls, done):
    given = recordings()._replace(smoother=smoother)
    given = given if controls else given._replace(controls=None)
    remarks = identification_result(finished[0], given, finished[1])["remarks"]
    told = [each for each in remarks if each.startswith(f"The positions are smoothed ({smoother})")]
    assert len(told) == (done is not None)
    assert all(done in each for each in told)


def test_calibrated_vehicle_has_the_estimate_and_its_origin(finished):
    whole, result = finished
    content = identification_result(whole, recordings(), result)
    calibrated = result.calibrated(whole.spec, "a test")
    origin = vehicle_provenance({"seed": 0}, content, "kbm")
    assert calibrated.wheelbase.initial == pytest.approx(
        content["parameters"]["wheelbase"]["estimate"]
    )
    assert origin["fitted"] == ["wheelbase"]
    assert {"seed", "smoother", "assumed", "loss_after", "heldout_after"} <= set(origin)


def straight(index, steps=60):
    """A motion along the x axis, of constant speed, which every vehicle follows exactly."""
    still = torch.zeros(steps)
    ahead = torch.arange(steps) + 100.0 * index
    velocity = torch.tensor([SPEED_MPS, 0.0]).expand(steps, 2)
    return Motion(torch.stack([0.1 * SPEED_MPS * ahead, still], -1), still, velocity, still)


def test_tracks_that_are_followed_exactly_have_a_flat_profile():
    exact = Recordings({f"rider_{index}": straight(index) for index in range(2)})
    with double_precision():
        sized = study(controls=None, tracks=1, profile=["wheelbase"])
        profile = sized(exact, builders("kbm")).profiles["wheelbase"]
    assert max(profile.costs) == pytest.approx(0.0, abs=1e-9)


def test_motions_are_given_as_arrays_of_a_figure(finished):
    names = {motion.arrays()["name"] for motion in finished[1].motions()}
    assert names == {segment.name for segment in finished[1].split.fitted}


def test_controls_of_another_model_are_refused():
    with pytest.raises(ValueError, match="`controls` must name acceleration, steer in this order"):
        study(controls={"steer": 0.1})(recordings(), builders("kbm"))


@pytest.mark.parametrize(
    ("column", "unit", "told"),
    [
        (1, 180 / math.pi, r"`controls\.steer` must lie within .* 0\.7854, but got 244 of 244"),
        (0, 9.81, r"`controls\.acceleration` must lie within .* -5 to 4, but got 183 of 244"),
    ],
    ids=["degrees", "gravities"],
)
def test_recorded_controls_of_another_unit_are_refused(column, unit, told):
    given = recordings()
    controls = {name: each.clone() for name, each in given.controls.items()}
    for index, each in enumerate(controls.values()):
        each[:, 0] += 0.5 * index
        each[:, column] *= unit
    with pytest.raises(ValueError, match=told):
        study()(given._replace(controls=controls), builders("kbm"))


def test_tracks_without_a_known_control_hold_no_segment():
    given = recordings()
    unknown = {name: torch.full_like(each, math.nan) for name, each in given.controls.items()}
    with pytest.raises(ValueError, match="recorded controls"):
        study()(given._replace(controls=unknown), builders("kbm"))


def test_recorded_controls_of_other_columns_are_refused():
    given = recordings()
    wide = {name: torch.cat([each, each], -1) for name, each in given.controls.items()}
    with pytest.raises(ValueError, match=r"2 columns \(acceleration, steer\)"):
        study()(given._replace(controls=wide), builders("kbm"))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("models", "error", "told"),
    [
        ({}, ValueError, "`models` must name at least one model"),
        ({"kbm": DiffKBM(load_vehicle("bicycle"))}, TypeError, "must build a model, but got Diff"),
    ],
)
def test_models_that_are_none_or_built_already_are_refused(models, error, told):
    with pytest.raises(error, match=told):
        study()(recordings(), models)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"folds": 1}, "`folds` must be 0 or at least 2, but got 1"),
        ({"folds": -1}, "`folds` must be 0 or at least 2"),
        ({"dt_s": 0.05}, "`segments.dt_s` must be that of the study, 0.05, but got 0.1"),
        ({"selection": ExcitationSelection(dt_s=0.2)}, "`selection.dt_s` must be that of the"),
        ({"prediction_s": 2.1}, "`prediction_s` must be at most half of a segment, but got 2.1 of"),
        ({"prediction_s": 0.0}, "`prediction_s` must be at least 0.1"),
    ],
)
def test_a_study_that_cannot_be_is_refused_before_it_begins(options, told):
    with pytest.raises(ValueError, match=told):
        study(**options)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("name", ["tracks", "heldout", "folds"])
def test_a_count_that_is_not_whole_is_refused_before_it_begins(name):
    with pytest.raises(ValueError, match=f"`{name}` must be a whole number, but got 2.5"):
        study(**{name: 2.5})


@pytest.mark.parametrize("names", [["holonomic"], ["kbm", "holonomic"]])
def test_a_model_that_no_acceleration_drives_is_refused_by_name(names):
    told = "have the control `acceleration` to be identified, but got Holonomic with velocity_x"
    study().require_models(builders("kbm", "unicycle"))
    with pytest.raises(ValueError, match=told):
        study().require_models(builders(*names))
