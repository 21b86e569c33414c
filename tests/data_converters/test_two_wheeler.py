"""Two-wheeler recordings: axes, lean, pieces, faults, and the real data."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from data_converters import (
    ConversionError,
    ConversionSettings,
    Mode,
    RejectReason,
    TrackError,
    TwoWheelerDataset,
    convert,
)
from data_converters.two_wheeler.reader import lean_to_the_left, read_boxes

STEMS, MODES = ("bicycle", "motorcycle", "scooter"), (Mode.BICYCLE, Mode.MOTORCYCLE, Mode.SCOOTER)
HEIGHT_M, SPEED_MPS, RADIUS_M, LEAN = 1.8, 5.0, 10.0, 0.25


def ride(stem, folder, seconds=39.0):
    """A left circle in the sensor's frame (y up), 2 Hz, leaning inwards."""
    time = np.arange(0.0, seconds, 0.5)
    course = SPEED_MPS / RADIUS_M * time
    east, north = RADIUS_M * np.sin(course), -RADIUS_M * np.cos(course)
    # box axes: x forward, y left, z up before leaning about the forward axis; then z, x, y = world
    axes = Rotation.from_euler("ZX", np.stack([course, np.full_like(course, -LEAN)], 1)).as_matrix()
    centre = np.stack([east, north, np.zeros_like(east)], 1) + 0.5 * HEIGHT_M * axes[:, :, 2]
    to_sensor = [1, 2, 0]
    quaternion = Rotation.from_matrix(axes[:, to_sensor, :]).as_quat()
    table = pd.DataFrame(
        {"frame": (10 * time).astype(int), "time_s": time, "obj_id": 0}
        | dict(zip(("x", "y", "z"), centre[:, to_sensor].T, strict=True))
        | dict(zip(("qx", "qy", "qz", "qw"), quaternion.T, strict=True))
        | {"sx": 1.9, "sy": 0.6, "sz": HEIGHT_M}
    )
    table.to_csv(folder / f"{stem}.csv", index=False)
    return np.stack([east, north], 1)


@pytest.fixture
def rides(tmp_path):
    folder = tmp_path / "rides"
    folder.mkdir()
    for stem in STEMS:
        ride(stem, folder)
    return folder


@pytest.mark.parametrize("stem", STEMS)
def test_the_contact_line_is_found_under_the_leaning_box(rides, stem):
    boxes = read_boxes(rides / f"{stem}.csv")
    np.testing.assert_allclose(boxes.ground[:, :2], ride(stem, rides), atol=1e-9)
    np.testing.assert_allclose(boxes.ground[:, 2], 0.0, atol=1e-9)


def test_a_left_turn_leans_to_the_left(rides):
    boxes = read_boxes(rides / "scooter.csv")
    velocity = np.gradient(boxes.ground[:, :2], boxes.time_s, axis=0)
    np.testing.assert_allclose(lean_to_the_left(boxes.upright, velocity)[1:-1], LEAN, atol=1e-3)


@pytest.mark.parametrize("moved_m", [0.0, 2.0])
def test_of_two_boxes_at_one_time_the_first_is_taken(rides, moved_m) -> None:
    alone = read_boxes(rides / "bicycle.csv")
    table = pd.read_csv(rides / "bicycle.csv")
    pd.concat([table, table.assign(x=table["x"] + moved_m)]).to_csv(rides / "bicycle.csv")
    both = read_boxes(rides / "bicycle.csv")
    np.testing.assert_array_equal(both.time_s, alone.time_s)
    np.testing.assert_array_equal(both.ground, alone.ground)


@pytest.mark.parametrize(("stem", "mode"), zip(STEMS, MODES, strict=True))
def test_pieces_share_no_sample_and_fill_all_splits(rides, stem, mode):
    dataset = TwoWheelerDataset(rides)
    scenes = [scene for scene in dataset.scenes() if scene.name.startswith(stem)]
    raws = [dataset.read(scene, 0.1, strict=True) for scene in scenes]
    assert sum(len(raw.tracks[0].time_s) for raw in raws) == 78
    assert {scene.split for scene in scenes} == {"train", "val", "test"}
    assert {scene.recording for scene in scenes} == {stem}
    assert [raw.tracks[0].mode for raw in raws] == [mode] * 4


def test_the_lean_stands_beside_the_agents(rides, tmp_path):
    convert(ConversionSettings(TwoWheelerDataset(rides), tmp_path / "cache", progress=False))
    folder = tmp_path / "cache" / "two_wheeler" / "motorcycle_1"
    lean = pd.read_parquet(folder / "lean.parquet")
    assert set(lean.columns) == {"agent_id", "time_s", "lean"}
    np.testing.assert_allclose(lean["lean"], LEAN, atol=0.02)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", RejectReason.MISSING_FIELD),
        ("time_s,obj_id,x\n0,0,1\n", RejectReason.MISSING_FIELD),
        ("obj_id,x\n0,1\n", RejectReason.NO_TIMESTAMPS),
        ("time_s,obj_id,x,y,z,qx,qy,qz,qw,sx,sy,sz\n", RejectReason.NOT_FINITE),
        (
            "time_s,obj_id,x,y,z,qx,qy,qz,qw,sx,sy,sz\n0,0,1,nan,1,0,0,0,1,1,1,1\n",
            RejectReason.NOT_FINITE,
        ),
    ],
)
def test_a_faulty_file_is_refused_with_its_name(text, reason, tmp_path):
    path = tmp_path / "bicycle.csv"
    path.write_text(text)
    with pytest.raises(TrackError, match=r"bicycle\.csv") as caught:
        read_boxes(path)
    assert caught.value.reason is reason


def test_a_faulty_file_is_counted_and_the_others_kept(rides, tmp_path):
    (rides / "scooter.csv").write_text("")
    settings = ConversionSettings(TwoWheelerDataset(rides), tmp_path / "cache", progress=False)
    report = convert(settings)
    assert report.rejected_by_reason == {RejectReason.MISSING_FIELD: 1}


def test_a_folder_without_rides_is_named(tmp_path):
    with pytest.raises(ConversionError, match="bicycle.csv"):
        TwoWheelerDataset(tmp_path).scenes()


@pytest.mark.parametrize("mode", STEMS)
def test_the_real_riders_lean_into_their_turns(mode, shared):
    folder = shared / "data" / "two_wheeler"
    boxes = read_boxes(folder / f"{mode}.csv")
    velocity = np.gradient(boxes.ground[:, :2], boxes.time_s, axis=0)
    force = np.gradient(velocity, boxes.time_s, axis=0)
    across = velocity[:, 0] * force[:, 1] - velocity[:, 1] * force[:, 0]
    lean = lean_to_the_left(boxes.upright, velocity)
    assert np.corrcoef(lean, across / np.linalg.norm(velocity, axis=1))[0, 1] > 0.8
