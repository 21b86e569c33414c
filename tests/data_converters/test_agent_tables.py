"""Tables of the samples of many agents, and recordings that are made of them."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from data_converters import Mode, RejectReason, TrackError
from data_converters.agent_tables import add_tracks, named_agents, on_shared_clock
from data_converters.modes import default_extent
from data_converters.multi_agent import MultiAgentDataset, Recording
from data_converters.recordings import RawScene

NAN = float("nan")


def rows_of(agent="a", time_s=(0.0, 0.1, 0.2), **columns):
    """Samples of an agent, a rider who moves east at 1 m/s unless told otherwise."""
    told = {"agent": agent, "mode": float(Mode.BICYCLE), "time_s": list(time_s), "source": "file"}
    told |= {"x": list(time_s), "y": [0.0] * len(time_s)}
    return pd.DataFrame(told | columns)


def added(*tables):
    raw = RawScene()
    add_tracks(raw, pd.concat(tables, ignore_index=True), strict=False)
    return raw


def reasons(raw):
    return {each.track: each.reason for each in raw.rejected}


def test_samples_come_in_the_order_of_time_and_the_first_of_a_time_counts():
    table = rows_of(time_s=(0.2, 0.0, 0.1, 0.1, 0.0), x=[2.0, 0.0, 1.0, 1.5, 0.5], z=[5.0] * 5)
    raw = added(table)
    (track,) = raw.tracks
    assert track.time_s.tolist() == [0.0, 0.1, 0.2]
    assert track.position.tolist() == [[0.0, 0.0, 5.0], [1.0, 0.0, 5.0], [2.0, 0.0, 5.0]]
    assert raw.notes["repeated_timestamps"] == 2
    assert (track.name, track.mode, track.source) == ("a", Mode.BICYCLE, "file")


def test_a_table_without_heights_is_flat():
    assert added(rows_of()).tracks[0].position[:, 2].tolist() == [0.0] * 3


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        (rows_of(time_s=(0.1, 0.1)), RejectReason.REPEATED_TIMESTAMPS),
        (rows_of(time_s=(0.0, 0.1, 0.1), y=[3.0, 3.0, 4.1]), RejectReason.TWO_PLACES),
        (rows_of(x=[0.0, NAN, 1.0]), RejectReason.NOT_FINITE),
        (rows_of(z=[0.0, np.inf, 1.0]), RejectReason.NOT_FINITE),
        (rows_of(mode=NAN, label="ufo"), RejectReason.UNKNOWN_CLASS),
        (rows_of(mode=[2.0, 2.0, 5.0]), RejectReason.UNKNOWN_CLASS),
    ],
)
def test_an_agent_that_cannot_be_used_costs_no_other(rows, reason):
    raw = added(rows, rows_of("b", **{"z": 0.0} if "z" in rows else {}))
    assert [track.name for track in raw.tracks] == ["b"]
    assert reasons(raw) == {"a": reason}
    assert raw.rejected[0].source == "file"


def test_one_sample_and_two_of_one_place_are_no_fault_of_the_clock():
    raw = added(rows_of(time_s=(0.3,)), rows_of("b", (0.0, 0.1, 0.1), y=[0.0, 0.0, 1.0]))
    assert [len(track.time_s) for track in raw.tracks] == [1, 2]


def test_what_a_row_tells_of_its_fault_is_told():
    raw = added(rows_of(x=[0.0, NAN, 1.0], fault=[None, "the row is torn", None]))
    assert raw.rejected[0].detail == "the row is torn"


@pytest.mark.parametrize(
    ("columns", "remedy"),
    [
        ({"label": "ufo", "advice": "Call it a bird."}, "Call it a bird."),
        ({"label": "ufo"}, "Map it to a mode."),
        ({"mode": [2.0, 2.0, 5.0]}, "Give it one class"),
    ],
)
def test_a_class_that_is_not_known_tells_what_to_do(columns, remedy):
    assert remedy in added(rows_of(**({"mode": NAN} | columns))).rejected[0].detail


def test_speeds_are_those_of_all_rows_or_none():
    tracks = added(rows_of(speed=[1.0, 2.0, 3.0]), rows_of("b", speed=[1.0, NAN, 3.0])).tracks
    assert tracks[0].speed.tolist() == [1.0, 2.0, 3.0]
    assert tracks[1].speed is None
    assert added(rows_of()).tracks[0].speed is None


def test_a_heading_that_is_missing_is_the_one_before():
    assert added(rows_of(heading=[0.1, NAN, 0.3])).tracks[0].heading.tolist() == [0.1, 0.1, 0.3]


def test_sizes_are_medians_and_what_is_not_stated_is_usual():
    sizes = {"length": [2.0, 1.8, 9.0], "width": NAN}
    extent = added(rows_of(**sizes)).tracks[0].extent
    usual = default_extent(Mode.BICYCLE)
    assert (extent.length, extent.width, extent.height) == (2.0, usual.width, usual.height)
    assert added(rows_of(width=NAN)).tracks[0].extent is None


def test_agents_without_a_name_are_counted_together():
    raw = RawScene()
    table = pd.concat([rows_of("a"), rows_of(None), rows_of(NAN)])
    assert set(named_agents(table, "file.csv", raw, strict=False)["agent"]) == {"a"}
    (one,) = raw.rejected
    assert (one.track, one.source, one.reason) == ("unnamed", "file.csv", RejectReason.NO_AGENT)
    assert "none in 6 of 9 rows" in one.detail
    with pytest.raises(TrackError, match="`agent` must have a name"):
        named_agents(table, "file.csv", RawScene(), strict=True)


def test_who_is_years_away_and_who_rides_for_years_are_left_out():
    start = 1.7e9
    near = [rows_of("a", (start, start + 50.0)), rows_of("b", (start + 40.0, start + 100.0))]
    away = [rows_of("past", (0.0,)), rows_of("long", (start, start + 1e6))]
    away.append(rows_of("clockless", (NAN, NAN)))  # refused by itself
    raw = RawScene()
    table = on_shared_clock(pd.concat([*near, *away]), 100.0, raw, strict=False)
    assert set(table["agent"]) == {"a", "b", "clockless"}
    assert reasons(raw) == dict.fromkeys(("long", "past"), RejectReason.TIME_SPAN)
    told = {each.track: each.detail for each in raw.rejected}
    assert "cover at most 100 s for one agent" in told["long"]
    assert "be within 100 s of the other agents" in told["past"]
    whole = pd.concat(near)
    assert on_shared_clock(whole, 100.0, RawScene(), strict=True) is whole


class Dealt:
    """Deals every recording to val, and remembers their sizes."""

    def deal(self, sizes):
        self.sizes = dict(sizes)
        return dict.fromkeys(sizes, "val")


@dataclass(frozen=True)
class Toy(MultiAgentDataset):
    """Files of a folder; `given` holds the samples by the names of the files."""

    name = "toy"
    location = "nowhere"
    expects = "files"

    given: dict = field(default_factory=dict)
    known: tuple = ()

    def recordings(self):
        return list(self.known)

    def table(self, path, recording, raw):
        raw.side_tables["lights"] = pd.DataFrame({"time_s": [8.0, 9.0]})
        return rows_of(time_s=()) if self._repeats(path, raw) else self.given[path.name]


@pytest.fixture
def toy(tmp_path):
    for name, content in (("a", "1" * 100), ("b", "2" * 50), ("c", "1" * 100), ("d", "4" * 7)):
        (tmp_path / name).write_text(content)
    given = {
        "a": rows_of("one", (5.0, 6.0)).drop(columns="source"),
        "b": rows_of("two", (7.0, 7.5)).drop(columns="source"),
        "d": rows_of(time_s=()),
    }

    def build(*recordings):
        known = tuple(
            Recording(name, tuple(tmp_path / file for file in files), *rest)
            for name, files, *rest in recordings
        )
        return Toy(tmp_path, Dealt(), given=given, known=known)

    return build


@pytest.mark.usefixtures("unchecked")
def test_recordings_are_dealt_by_the_bytes_of_their_groups(toy):
    dataset = toy(("x", "ab", None, "g"), ("y", "c", None, "g"), ("z", "d"), ("t", "d", "test"))
    scenes = {scene.name: scene.split for scene in dataset.scenes()}
    assert dataset.split.sizes == {"g": 250.0, "z": 7.0}
    assert scenes == {"x": "val", "y": "val", "z": "val", "t": "test"}


@pytest.mark.usefixtures("unchecked")
def test_files_and_side_tables_of_a_recording_share_a_clock_that_begins_with_it(toy):
    raw = toy(("x", "ab")).read(SimpleNamespace(key="x"), 0.1, strict=True)
    assert {track.name: track.time_s.tolist() for track in raw.tracks} == {
        "one": [0.0, 1.0],
        "two": [2.0, 2.5],
    }
    assert raw.side_tables["lights"]["time_s"].tolist() == [3.0, 4.0]
    assert [track.source for track in raw.tracks] == ["a", "b"]


@pytest.mark.usefixtures("unchecked")
def test_a_file_that_repeats_another_and_one_without_samples_are_counted(toy, tmp_path):
    raw = toy(("x", "acd"), ("y", "c")).read(SimpleNamespace(key="x"), 0.1, strict=False)
    assert [track.name for track in raw.tracks] == ["one"]
    assert reasons(raw) == {"c": RejectReason.CONTAINED, "d": RejectReason.TOO_SHORT}
    repeated, empty = raw.rejected
    assert repeated.source == f"{tmp_path}/c"
    assert repeated.detail == f"{tmp_path}/c repeats {tmp_path}/a"
    assert empty.source == "d"
