"""Autobike logs: units, clocks, sensors beside the scene, what is refused, and the real data."""

import numpy as np
import pandas as pd
import pytest

from data_converters import (
    AutobikeDataset,
    ConversionSettings,
    Mode,
    RejectReason,
    TrackError,
    convert,
)
from data_converters.autobike.quality import LogQuality
from data_converters.autobike.reader import LARGEST, read_log
from diffstack_mmv.data import ConvertedCache, read_controls, read_leans, read_sensors, read_tracks
from tests.data_converters.synthetic import (
    RADIUS_M,
    WRITERS,
    autobike_log,
    first_scene,
    ride,
    times,
)

LATITUDE, TIME, WHEEL = "Lat GPS (deg)", "Time (ms)", "Speed VESC (rad/s)"
GYRO = "Gyroscope Z (rad/s)"
ANGLES = (LATITUDE, "Long GPS (deg)")


@pytest.fixture
def log(tmp_path):
    """Write one log, changed by a function of its table, and tell its path."""

    def build(change=lambda table: table):
        path = tmp_path / "09_06" / "1.csv"
        path.parent.mkdir()
        change(autobike_log()).to_csv(path, index=False, float_format="%.12f")
        return path

    return build


def test_radians_become_metres_and_a_position_counts_when_it_is_new(log):
    read = read_log(log())
    assert np.diff(read.fixes.time_s) == pytest.approx(0.1)
    expected = ride(times(100.0, 20.0), 1.0).position[::10]
    np.testing.assert_allclose(read.fixes.position, expected - expected[0], atol=2e-4)


def test_a_file_in_degrees_is_read_as_its_header_says(log):
    angles = [LATITUDE, "Long GPS (deg)"]
    path = log(lambda table: table.assign(**{name: np.rad2deg(table[name]) for name in angles}))
    expected = ride(times(100.0, 20.0), 1.0).position[::10]
    np.testing.assert_allclose(read_log(path).fixes.position, expected - expected[0], atol=2e-4)


def test_a_bicycle_that_stands_keeps_its_position(log):
    def stand(table):
        still = table.index >= 1500
        held = {name: table[name].where(~still, table[name][1499]) for name in table.columns[:2]}
        return table.assign(**held, **{WHEEL: table[WHEEL].where(~still, 0.0)})

    assert np.diff(read_log(log(stand)).fixes.time_s) == pytest.approx(0.1)


@pytest.mark.parametrize(("wheel", "count"), [(0.0, 7), (0.09, 7), (0.2, 2)])
def test_a_position_is_due_at_rest_alone(log, wheel, count):
    def roll(table):
        held = {name: table[name].where(table.index >= 60, table[name][0]) for name in ANGLES}
        return table[:70].assign(**held, **{WHEEL: wheel})

    assert read_log(log(roll)).fixes.time_s == pytest.approx(
        875.426 + 0.1 * (np.arange(7) if count == 7 else np.array([0, 6]))
    )


@pytest.mark.parametrize("column", [name for name in LARGEST if name != TIME])
def test_what_no_instrument_can_tell_is_counted_and_unknown(log, column):
    def exceed(table):
        values = table[column].copy()
        values[[20, 30]] = np.array([1.0, -1.0]) * LARGEST[column] * 1.001
        return table.assign(**{column: values})

    assert read_log(log(exceed)).unusable == 2


def test_rows_without_a_position_are_counted(log):
    path = log(lambda table: table.assign(**{LATITUDE: table[LATITUDE].where(table.index > 2, 0)}))
    assert read_log(path).unusable == 3


def test_sensors_are_those_of_the_source_with_lean_to_the_left(log):
    path = log()
    table, read = pd.read_csv(path), read_log(path).sensors
    assert read["lean"].tolist() == (-table["State Estimate Roll (rad)"]).tolist()
    assert read["yaw_rate"].tolist() == table[GYRO].tolist()


@pytest.mark.parametrize(("seconds", "rides"), [(0.5, False), (7.9, False), (8.5, True)])
def test_a_log_rides_for_eight_seconds(log, seconds, rides):
    path = log(lambda table: table[: round(100 * seconds)])
    if rides:
        LogQuality().check(read_log(path), path)
    else:
        with pytest.raises(TrackError, match="`log` must ride for 8 s"):
            LogQuality().check(read_log(path), path)


def test_yaw_rates_of_the_path_are_those_of_the_gyroscope(log):
    path = log()
    # whatever correlates: the residual alone decides
    LogQuality(correlation=2.0, residual_radps=0.03).check(read_log(path), path)


def test_known_bad_logs_take_no_part_in_the_deal(tmp_path):
    WRITERS["autobike"](tmp_path)
    before = {scene.name: scene.split for scene in AutobikeDataset(tmp_path).scenes()}
    for number in range(3, 9):
        path = tmp_path / "unclean" / "10_06" / f"{number}.csv.gz"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"bad")
    after = {scene.name: scene.split for scene in AutobikeDataset(tmp_path).scenes()}
    assert after == before | {f"10_06_{number}": "train" for number in range(3, 9)}


@pytest.mark.parametrize(("metres", "pieces"), [(0.59, 1), (0.61, 2)])
def test_the_receiver_steps_where_it_is_faster_than_six_metres_per_second(log, metres, pieces):
    def step(table):
        before, after = (table.loc[row, [*ANGLES]].to_numpy() for row in (1190, 1200))
        north, east = RADIUS_M * (after - before) * [1.0, np.cos(before[0])]
        moved = np.sqrt(metres**2 - east**2) - north
        stepped = table[LATITUDE] + moved / RADIUS_M * (table.index >= 1200)
        return table.assign(**{LATITUDE: stepped})

    dataset = AutobikeDataset(log(step).parents[1], quality=LogQuality(residual_radps=1.0))
    assert len(first_scene(dataset).tracks) == pieces


def test_sensors_before_the_first_position_are_of_the_first_agent(log):
    def late(table):
        stepped = table[LATITUDE] + 2e-7 * (table.index >= 1200)
        return table.assign(**{LATITUDE: stepped.where(table.index >= 100, 0.0)})

    dataset = AutobikeDataset(log(late).parents[1], quality=LogQuality(residual_radps=1.0))
    controls = first_scene(dataset).side_tables["controls"]
    assert set(controls["agent_id"][controls["time_s"] < 0.0]) == {"bicycle"}
    assert controls["time_s"].min() == pytest.approx(-1.0)


def test_rows_that_repeat_a_time_are_dropped(log):
    path = log(lambda table: pd.concat([table, table[:50]]).sort_values(TIME, kind="stable"))
    read = read_log(path)
    assert read.repeated == 50
    assert np.diff(read.time_s).min() > 0.0


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda t: t.assign(**{WHEEL: 0.0}), RejectReason.WHEEL_SPEED),
        (lambda t: t.assign(**{WHEEL: 0.6 * t[WHEEL]}), RejectReason.WHEEL_SPEED),
        (lambda t: t.assign(**{WHEEL: 1.3 * t[WHEEL]}), RejectReason.WHEEL_SPEED),
        (lambda t: t.assign(**{GYRO: -t[GYRO]}), RejectReason.GYRO),
        (
            lambda t: t.assign(**{GYRO: 0.6 * t[GYRO] + 0.2 * np.sin(0.025 * t.index)}),
            RejectReason.GYRO,
        ),
        (lambda t: t.assign(**{LATITUDE: 0.0}), RejectReason.NO_POSITION),
        (lambda t: t.assign(**{TIME: 5.0}), RejectReason.NO_TIMESTAMPS),
        (lambda t: t.drop(columns=WHEEL), RejectReason.MISSING_FIELD),
        (lambda t: t.drop(columns=TIME), RejectReason.NO_TIMESTAMPS),
        (lambda t: t[:500], RejectReason.TOO_SHORT),
    ],
    ids=[
        "dead wheel",
        "slow wheel",
        "fast wheel",
        "mirrored gyro",
        "weak gyro",
        "no fix",
        "no clock",
        "no wheel",
        "no time",
        "short",
    ],
)
def test_a_log_that_cannot_be_used_is_refused_with_its_reason(log, tmp_path, change, reason):
    log(change)
    dataset = AutobikeDataset(tmp_path)
    with pytest.raises(TrackError, match=r"1\.csv") as caught:
        dataset.read(dataset.scenes()[0], 0.1, strict=True)
    assert caught.value.reason is reason


def test_a_step_of_the_receiver_begins_another_agent(log, tmp_path):
    def step(table):
        return table.assign(**{LATITUDE: table[LATITUDE] + 2e-7 * (table.index >= 1200)})

    log(step)
    dataset = AutobikeDataset(tmp_path)
    raw = dataset.read(dataset.scenes()[0], 0.1, strict=True)
    assert [track.name for track in raw.tracks] == ["bicycle", "bicycle_p1"]
    assert raw.side_tables["controls"].groupby("agent_id")["time_s"].max()["bicycle"] < 12.0


def test_a_copy_of_a_log_is_left_out(tmp_path):
    WRITERS["autobike"](tmp_path)
    path = tmp_path / "recordings" / "09_06" / "0.csv.gz"
    copy = tmp_path / "recordings" / "10_06" / "0.csv.gz"
    copy.parent.mkdir()
    copy.write_bytes(path.read_bytes())
    settings = ConversionSettings(AutobikeDataset(tmp_path), tmp_path / "cache", progress=False)
    assert convert(settings).rejected_by_reason == {RejectReason.CONTAINED: 1}


def test_controls_sensors_and_lean_are_read_beside_the_track(tmp_path):
    WRITERS["autobike"](tmp_path / "raw")
    dataset = AutobikeDataset(tmp_path / "raw")
    convert(ConversionSettings(dataset, tmp_path / "cache", progress=False))
    place = ConvertedCache("autobike", str(tmp_path / "cache")), ("train",), "bicycle"
    ((name, motion),) = list(read_tracks(*place).items())[:1]
    truth = ride(0.1 * np.arange(6, 6 + len(motion.heading)) + 0.05, 1.0)
    controls = read_controls(*place, ["steer", "speed"])[name].numpy()
    # the wheel is 3 % fast, and the steering acts through the inclined head axis
    np.testing.assert_allclose(controls[:-1, 1] / truth.speed[:-1], 1.03, atol=0.01)
    ground = np.sin(1.2217) * 1.165 * truth.yaw_rate / truth.speed
    np.testing.assert_allclose(np.tan(controls[:-1, 0]), ground[:-1], atol=5e-3)
    sensors = read_sensors(*place, ["yaw_rate"])[name].numpy()
    np.testing.assert_allclose(sensors[:-1, 0], truth.yaw_rate[:-1], atol=0.01)
    lean = read_leans(*place)[name].numpy()
    assert np.corrcoef(lean[:-1], truth.yaw_rate[:-1])[0, 1] > 0.99


@pytest.mark.parametrize("session", ["recordings/09_06/13", "unclean/26_05/9", "unclean/02_06/1"])
def test_real_logs_are_clean_or_refused_as_known(shared, tmp_path, session):
    path = tmp_path / f"{session}.csv.gz"
    path.parent.mkdir(parents=True)
    path.symlink_to(shared / "data" / "autobike" / f"{session}.csv.gz")
    dataset = AutobikeDataset(tmp_path)
    raw = dataset.read(dataset.scenes()[0], 0.1, strict=False)
    assert [track.mode for track in raw.tracks] == [Mode.BICYCLE] * session.startswith("rec")
    assert len(raw.rejected) == session.startswith("unclean")
