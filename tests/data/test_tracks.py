"""What stands beside whole tracks: their noise, their controls, their lean."""

import json

import numpy as np
import pandas as pd
import pytest

from diffstack_mmv.data import (
    ConvertedCache,
    read_controls,
    read_leans,
    read_rides,
    recorded_noise,
    recorded_sampling,
    recorded_step,
)
from diffstack_mmv.types import Mode
from tests.data.conftest import ToyAgent, write_cache


@pytest.fixture
def told(tmp_path):
    """A cache whose report tells this of the smoother's residual."""

    def write(**residual) -> ConvertedCache:
        folder = tmp_path / "toy"
        folder.mkdir()
        totals = {"totals": {"smoother_residual": {"bicycle": residual}}}
        (folder / "conversion_report.json").write_text(json.dumps(totals))
        return ConvertedCache("toy", str(tmp_path))

    return write


@pytest.mark.parametrize(("step_s", "share"), [(0.4, 2.0), (0.1, 1.0), (0.025, 0.5)])
def test_steps_between_sparse_samples_count_for_less(told, step_s, share):
    source = told(
        along_m=0.01, across_m=0.01, noise_along_m=0.08, noise_across_m=0.06, step_s=step_s
    )
    noise = recorded_noise(source, "bicycle", 0.1)
    assert noise == pytest.approx((0.08 * share, 0.06 * share))


@pytest.mark.parametrize(
    ("mode", "noise", "warning"),
    [
        ("bicycle", (0.08, 0.06), "Convert again"),
        ("bicycle", (0.08, 0.0), "Convert again"),
        ("bicycle", (0.0, 0.06), "Convert again"),
        ("scooter", None, ""),
    ],
)
def test_a_report_without_noise_is_warned_of(told, caplog, mode, noise, warning):
    along_m, across_m = noise or (0.08, 0.06)
    assert recorded_noise(told(along_m=along_m, across_m=across_m), mode, 0.1) == noise
    assert warning in caplog.text
    assert bool(caplog.text) == bool(warning)


def test_what_was_not_smoothed_tells_no_noise_and_needs_no_new_conversion(told, caplog):
    assert recorded_noise(told(along_m=0.0, across_m=0.0), "bicycle", 0.1) == (0.0, 0.0)
    assert not caplog.text


@pytest.mark.parametrize(
    ("residual", "step_s", "warned"),
    [({"step_s": 0.08}, 0.08, False), ({}, 0.1, True)],
    ids=("told", "older report"),
)
def test_recorded_step_is_that_of_the_report_or_said_to_be_taken(
    told, caplog, residual, step_s, warned
):
    source = told(along_m=0.1, **residual)
    assert recorded_step(source, "bicycle", 0.1) == step_s
    assert ("0.1 s is taken, that of the tracks. Convert again" in caplog.text) == warned
    assert recorded_step(source, "scooter", 0.1) == 0.1


@pytest.mark.parametrize(
    ("scene", "found", "warned"),
    [
        ({"sampling": {"a": [0.65, 0.1], "b": [0.6, 0.08]}}, {"scene/a": (0.65, 0.1)}, False),
        ({}, {}, True),
    ],
    ids=("told", "older report"),
)
def test_a_report_tells_when_tracks_were_sampled_or_is_warned_of(
    tmp_path, caplog, scene, found, warned
):
    (tmp_path / "toy").mkdir()
    report = json.dumps({"scenes": [{"name": "scene"} | scene]})
    (tmp_path / "toy" / "conversion_report.json").write_text(report)
    assert recorded_sampling(ConvertedCache("toy", str(tmp_path)), ["scene/a"]) == found
    assert ("when 1 of 1 tracks were sampled" in caplog.text) == warned


@pytest.fixture
def ride(tmp_path):
    """A cache with one ride in two parts and another rider, and a writer of tables beside it."""
    parts = [ToyAgent("track", Mode.BICYCLE, 40), ToyAgent("track_s1", Mode.BICYCLE, 30, 50)]
    parts.append(ToyAgent("track_sam", Mode.BICYCLE, 30))
    write_cache(tmp_path, {"scene": ("train", parts)})

    def beside(stem, **columns) -> ConvertedCache:
        table = pd.DataFrame({"agent_id": "track"} | columns)
        table.to_parquet(tmp_path / "toy" / "scene" / f"{stem}.parquet")
        return ConvertedCache("toy", str(tmp_path))

    return beside


NAMES = ("acceleration", "steer")


def test_rides_need_no_sensors_beside_their_controls(ride):
    time_s = 0.1 * np.arange(40)
    source = ride("controls", time_s=time_s, steer=0.0 * time_s, speed=1.0 + time_s)
    rides = read_rides(source, ["train"], "bicycle")
    assert rides.controls["scene/track"][:, 1].numpy() == pytest.approx(1.0 + time_s)
    assert rides.sensors == {}


def test_sensors_that_are_there_must_hold_a_number(ride):
    columns = {"time_s": [0.0], "steer": [0.0], "speed": [1.0]}
    source = ride("controls", **columns)
    ride("sensors", time_s=[0.0], yaw_rate=[np.nan])
    with pytest.raises(ValueError, match="`sensors` must hold a number"):
        read_rides(source, ["train"], "bicycle")


def test_rides_without_controls_are_refused(ride):
    source = ride("sensors", time_s=[0.0], yaw_rate=[0.0])
    with pytest.raises(ValueError, match="`controls` must be recorded in controls.parquet"):
        read_rides(source, ["train"], "bicycle")


def test_controls_are_those_of_the_steps_they_were_recorded_in(ride):
    time_s = 0.02 * np.arange(400)
    source = ride(
        "controls", time_s=time_s, steer=time_s, acceleration=np.floor(10 * time_s + 1e-9)
    )
    found = read_controls(source, ["train"], "bicycle", NAMES)
    assert set(found) == {"scene/track", "scene/track_s1"}
    assert found["scene/track"][:, 0].numpy() == pytest.approx(np.arange(40))
    assert found["scene/track_s1"][0].tolist() == pytest.approx([50.0, 5.04])


def test_controls_recorded_rarely_are_interpolated_and_unknown_outside(ride):
    source = ride("controls", time_s=[1.0, 2.0], steer=[0.0, 1.0], acceleration=[0.0, 0.0])
    steer = read_controls(source, ["train"], "bicycle", NAMES)["scene/track"][:, 1].numpy()
    assert steer[14] == pytest.approx(0.45)
    assert np.isfinite(steer).nonzero()[0].tolist() == list(range(10, 21))


@pytest.mark.parametrize("step_s", [0.02, 0.1, 0.25])
def test_what_an_instrument_shows_while_it_fails_is_not_invented(ride, step_s):
    time_s = np.arange(0.0, 10.0, step_s)
    steer = np.where((time_s > 1.01) & (time_s < 2.49), np.nan, time_s)
    source = ride("controls", time_s=time_s, steer=steer, acceleration=time_s)
    ride("lean", time_s=time_s, lean=steer)
    found = read_controls(source, ["train"], "bicycle", NAMES)["scene/track"].numpy()
    assert np.isfinite(found[:, 0]).all()
    unknown = np.isnan(found[:, 1]).nonzero()[0]
    assert set(range(11, 24)) <= set(unknown) <= set(range(10, 25))
    lean = read_leans(source, ["train"], "bicycle")["scene/track"].numpy()
    assert set(range(11, 25)) == set(np.isnan(lean).nonzero()[0])


def test_rows_without_a_number_are_passed_over(ride):
    time_s = 0.1 * np.arange(100)
    steer = np.where(np.arange(100) % 7 == 3, np.nan, time_s)
    source = ride("controls", time_s=time_s, steer=steer, acceleration=np.nan)
    ride("lean", time_s=time_s, lean=steer)
    found = read_controls(source, ["train"], "bicycle", NAMES)["scene/track"].numpy()
    assert np.isnan(found[:, 0]).all()
    assert found[:, 1] == pytest.approx(0.1 * np.arange(40), abs=0.051)
    lean = read_leans(source, ["train"], "bicycle")["scene/track"].numpy()
    assert lean == pytest.approx(0.1 * np.arange(40))


@pytest.mark.parametrize(
    ("table", "column", "complaint"),
    [
        ("controls", "steer", "be columns of agent_id, time_s, steer, but got accel"),
        ("lean", "lean", r"be recorded in controls\.parquet"),
    ],
)
def test_controls_that_were_not_recorded_are_told(ride, table, column, complaint):
    source = ride(table, time_s=[0.0], **{column: [0.0]})
    with pytest.raises(ValueError, match=complaint):
        read_controls(source, ["train"], "bicycle", NAMES)


def test_all_parts_of_a_track_have_its_lean(ride):
    source = ride("lean", time_s=[0.0, 10.0], lean=[0.0, 1.0])
    found = read_leans(source, ["train"], "bicycle")
    assert float(found["scene/track_s1"][0]) == pytest.approx(0.5)


def test_a_rider_has_nothing_of_another_whose_name_begins_alike(ride):
    names = ["track", "track", "track_sam", "track_sam"]
    source = ride("lean", agent_id=names, time_s=[0.0, 10.0] * 2, lean=[0.0, 0.0, 1.0, 1.0])
    found = read_leans(source, ["train"], "bicycle")
    assert {name: set(lean.tolist()) for name, lean in found.items()} == {
        "scene/track": {0.0},
        "scene/track_s1": {0.0},
        "scene/track_sam": {1.0},
    }
