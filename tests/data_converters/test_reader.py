"""IMPTC track files: order, units and every fault."""

import json

import numpy as np
import pytest

from data_converters import Mode, RejectReason, TrackError
from data_converters.imptc.modes import CLASS_MODES
from data_converters.imptc.reader import (
    UTM32_OFFSET_M,
    TrackFilter,
    load_json,
    microseconds,
    parse_track,
    time_span_us,
)
from data_converters.imptc.sample.sensor import cuboid_edges

KEEP = TrackFilter()
START = 1_679_472_906_000_000


def content(count=5, class_id=2, **changes):
    samples = {
        str(i + 1): {
            "ts": str(START + 40_000 * i),
            "status": 2,
            "class_prob": 0.9,
            "coordinates": [float(i), 2.0, 0.1],
            "velocity": 36.0,
        }
        for i in range(count)
    }
    for sample in samples.values():
        sample.update(changes)
    return {"overview": {"class_id": class_id, "lenght": count}, "track_data": samples}


def test_samples_are_ordered_by_their_inner_timestamp_not_by_key():
    file = content(12)
    file["track_data"] = dict(reversed(file["track_data"].items()))
    track = parse_track(file, "here", KEEP)
    assert track.position[:, 0].tolist() == list(range(12))


@pytest.mark.parametrize("key", ["{}", "ts_{}"])
@pytest.mark.parametrize("kind", [int, str])
@pytest.mark.parametrize("scale", [1, 1000], ids=["us", "ms"])
def test_keys_and_timestamps_are_read_in_every_spelling(key, kind, scale):
    file = content()
    file["track_data"] = {
        key.format(i): {**sample, "ts": kind(int(sample["ts"]) // scale)}
        for i, sample in enumerate(file["track_data"].values())
    }
    track = parse_track(file, "here", KEEP)
    np.testing.assert_array_equal(track.timestamp, START + 40_000 * np.arange(5))


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (10**11, 10**14),  # of 1973 in milliseconds
        (10**14 - 1, (10**14 - 1) * 1000),
        (10**14, 10**14),  # of the same day in microseconds
        (10**17 - 1, 10**17 - 1),
    ],
)
def test_a_timestamp_is_milliseconds_below_those_of_1973_in_microseconds(value, expected):
    assert microseconds(value, "here") == microseconds(str(value), "here") == expected


@pytest.mark.parametrize("value", [0, 12, 1_679_472_906, 10**11 - 1, 10**17, 10**18, -5])
def test_a_timestamp_of_unknown_magnitude_is_refused(value):
    with pytest.raises(TrackError, match=f"microseconds.*got {value} in here") as caught:
        microseconds(value, "here")
    assert caught.value.reason is RejectReason.TIMESTAMP_UNIT


@pytest.mark.parametrize(("class_id", "mode"), CLASS_MODES.items())
def test_classes_are_mapped_by_id_whatever_their_name(class_id, mode):
    file = content(class_id=class_id)
    file["overview"]["class_name"] = "nonsense"
    assert parse_track(file, "here", KEEP).mode is mode


def test_speed_is_read_as_kilometres_per_hour():
    np.testing.assert_allclose(parse_track(content(), "here", KEEP).speed, 10.0)


def test_positions_move_to_utm_only_on_demand():
    local = parse_track(content(), "here", KEEP).position
    utm = parse_track(content(), "here", TrackFilter(utm=True)).position
    np.testing.assert_allclose(utm - local, np.tile(UTM32_OFFSET_M, (5, 1)))


@pytest.mark.parametrize(
    ("changes", "keep", "kept"),
    [
        ({"1": {"status": 1}, "2": {"status": 1}}, KEEP, [0, 1, 2, 3, 4, 5]),
        ({"1": {"status": 1}, "2": {"status": 1}}, TrackFilter(min_status=2), [2, 3, 4, 5]),
        ({"3": {"ts": str(START + 40_000)}}, KEEP, [0, 1, 3, 4, 5]),
    ],
    ids=["every status", "low status", "repeated timestamp"],
)
def test_samples_that_are_dropped_are_counted(changes, keep, kept):
    file = content(6)
    for key, change in changes.items():
        file["track_data"][key].update(change)
    track = parse_track(file, "here", keep)
    assert track.position[:, 0].tolist() == kept
    assert track.dropped == 6 - len(kept)


@pytest.mark.parametrize(
    ("file", "keep", "reason", "says"),
    [
        (content(class_id=1), KEEP, RejectReason.UNKNOWN_CLASS, "class_id.*got 1 in here"),
        (content(class_id="?"), KEEP, RejectReason.UNKNOWN_CLASS, "class_id"),
        (content(class_id=None), KEEP, RejectReason.UNKNOWN_CLASS, "class_id"),
        (content(ts=None), KEEP, RejectReason.NO_TIMESTAMPS, "ts"),
        (content(ts="soon"), KEEP, RejectReason.NO_TIMESTAMPS, "soon"),
        (content(0), KEEP, RejectReason.NO_TIMESTAMPS, "track_data"),
        (content(coordinates=[1.0, float("nan"), 0.0]), KEEP, RejectReason.NOT_FINITE, "nan"),
        (content(coordinates=[1.0, 2.0]), KEEP, RejectReason.NOT_FINITE, "coordinates"),
        (content(coordinates=["a", 2.0, 0.0]), KEEP, RejectReason.NOT_FINITE, "coordinates"),
        (content(status="?"), KEEP, RejectReason.LOW_STATUS, "status"),
        (content(status=None), KEEP, RejectReason.LOW_STATUS, "status"),
        (content(cuboid=[1]), KEEP, RejectReason.BROKEN_CUBOID, "cuboid"),
        (content(), TrackFilter(min_status=3), RejectReason.LOW_STATUS, "status"),
        (content(), TrackFilter(min_class_prob=0.95), RejectReason.LOW_PROBABILITY, "0.9"),
        ({"track_data": content()["track_data"]}, KEEP, RejectReason.MISSING_FIELD, "overview"),
        ([], KEEP, RejectReason.NO_TIMESTAMPS, "track_data"),
        ({"track_data": [1, 2]}, KEEP, RejectReason.NO_TIMESTAMPS, "track_data"),
    ],
)
def test_a_faulty_track_names_field_value_and_file(file, keep, reason, says):
    with pytest.raises(TrackError, match=says) as caught:
        parse_track(file, "here", keep)
    assert caught.value.reason is reason
    assert "here" in str(caught.value)


def test_the_span_of_a_track_is_from_its_earliest_to_its_latest_sample():
    file = content(4)
    file["track_data"] = dict(reversed(file["track_data"].items())) | {"5": "torn"}
    assert time_span_us(file, "here") == (START, START + 120_000)
    with pytest.raises(TrackError, match="`track_data` must hold samples, but got 'none' in here"):
        time_span_us({"track_data": {"1": "torn"}}, "here")


@pytest.mark.parametrize("place", [[1.0, float("inf"), 0.0], [1.0, 2.0, 0.0, 3.0], None])
def test_one_impossible_place_among_good_ones_is_named(place) -> None:
    file = content(5)
    file["track_data"]["3"]["coordinates"] = place
    with pytest.raises(TrackError, match=f"`coordinates`.*ts {START + 80_000}") as caught:
        parse_track(file, "here", KEEP)
    assert caught.value.reason is RejectReason.NOT_FINITE


@pytest.mark.parametrize("without", [["1"], ["3", "4"], ["5"], ["1", "2", "3", "4", "5"]])
def test_a_track_has_a_body_if_every_sample_has_a_cuboid(without) -> None:
    file = content(5, cuboid=cuboid_edges(np.zeros(3), 0.3, (4.0, 2.0, 1.5)).tolist())
    whole = parse_track(file, "here", KEEP)
    assert (whole.axis.shape, whole.extent.width) == ((5,), pytest.approx(2.0))
    for key in without:
        del file["track_data"][key]["cuboid"]
    part = parse_track(file, "here", KEEP)
    assert (part.axis, part.extent) == (None, None)


def test_a_byte_order_mark_is_no_damage(tmp_path):
    path = tmp_path / "track.json"
    path.write_text('\ufeff{"overview": {}}', encoding="utf-8")
    assert load_json(path) == {"overview": {}}


@pytest.mark.parametrize("text", ["", "{", '{"overview": {}, "track_da'])
def test_broken_json_names_the_file(tmp_path, text):
    path = tmp_path / "track.json"
    path.write_text(text)
    with pytest.raises(TrackError, match="track.json.*unpack") as caught:
        load_json(path)
    assert caught.value.reason is RejectReason.BROKEN_JSON


def test_the_size_of_a_vehicle_is_the_median_of_its_cuboids(sample):
    path = next(sample.glob("*/vehicles/*/track.json"))
    track = parse_track(json.loads(path.read_text()), "here", KEEP)
    assert track.mode in (Mode.CAR, Mode.TRUCK)
    assert 3.5 < track.extent.length < 10.0
    assert track.axis.shape == track.timestamp.shape
