"""Own tables: agents, types, scenes and recordings by their names."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from data_converters import (
    ConversionSettings,
    Mode,
    RejectReason,
    TableColumns,
    TrackError,
    convert,
)
from data_converters.tables.reading import names_of, read_table
from tests.data_converters.synthetic import TABLE_TIME_S, first_scene, table


def test_rows_without_an_agent_are_counted_and_numbers_stay_as_they_are(dataset):
    big = 12345678901234560
    parts = [table(agent=str(big + n), y=n) for n in range(3)]
    rows = pd.concat([*parts, table(agent=None)])
    raw = first_scene(dataset(tables={"day": rows}), strict=False)
    assert [track.name for track in raw.tracks] == [str(big + n) for n in range(3)]
    assert [(item.track, item.reason) for item in raw.rejected] == [
        ("unnamed", RejectReason.NO_AGENT)
    ]
    with pytest.raises(TrackError, match="`agent` must have a name.*none in 120 of 480 rows"):
        first_scene(dataset(tables={"day": rows}))


@pytest.mark.parametrize("kind", [2, 2.0, "2"])
def test_a_type_that_is_missing_costs_its_agent_alone(dataset, kind):
    rows = pd.concat([table(type=kind), table(agent=8, type=np.nan)])
    raw = first_scene(dataset(tables={"day": rows}, types={"2": "scooter"}), strict=False)
    assert [track.mode for track in raw.tracks] == [Mode.SCOOTER]
    assert [item.reason for item in raw.rejected] == [RejectReason.UNKNOWN_CLASS]


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        (
            "scoter",
            "Did you mean 'scooter'[?] Correct column 'type', or add .* [+]data.types.scoter=",
        ),
        (
            "horse",
            "'horse' in day.csv, agent 7. Correct column 'type', or add the type: [+]data.types",
        ),
        ("zebra crossing", "or add the type: `types`"),
        (np.nan, "'nan' in .* Fill in column 'type' in every row"),
        (np.where(TABLE_TIME_S < 5.0, "scooter", "car"), "'car, scooter' in .* Give it one class"),
    ],
)
def test_a_type_that_is_not_known_is_told_what_to_do(dataset, kind, says):
    with pytest.raises(TrackError, match=f"`type` must be one known class .*{says}"):
        first_scene(dataset(tables={"day": pd.concat([table(type=kind), table(agent=8)])}))


def test_names_in_a_parquet_file_are_those_of_a_csv_file(tmp_path):
    numbers = pd.Series([7.0, np.nan, 1234567890123456.0, 1234567890123457.0, 1.5])
    names = ["7", None, "1234567890123456", "1234567890123457", "1.5"]
    assert names_of(numbers).where(numbers.notna(), None).tolist() == names
    numbers.to_frame("agent").to_csv(tmp_path / "a.csv")
    again = names_of(read_table(tmp_path / "a.csv", {"agent"})["agent"])
    assert again.where(again.notna(), None).tolist() == names


@pytest.mark.parametrize("index", ["agent", ["agent", "time"]])
def test_columns_that_pandas_kept_as_the_index_of_a_parquet_file_are_read(tmp_path, index):
    rows = table(agent="a")
    rows.set_index(index).to_parquet(tmp_path / "day.parquet")
    read = read_table(tmp_path / "day.parquet", {"agent"})
    pd.testing.assert_frame_equal(read[rows.columns], rows.reset_index(drop=True))


@pytest.mark.parametrize("name", ["NA", "null", "None", "nan"])
def test_words_that_stand_for_nothing_in_a_text_file_are_told_to_be_no_names(dataset, name):
    rows = pd.concat([table(agent=name), table(agent="Nora", y=5.0)])
    with pytest.raises(TrackError, match=f"none in 120 of 240 rows.* {name}.* no names"):
        first_scene(dataset(tables={"day": rows}))


def test_stretches_and_agents_of_one_scene_have_names_of_their_own(dataset, tmp_path):
    rows = table(agent="a")[(TABLE_TIME_S < 5.0) | (TABLE_TIME_S > 7.0)]
    found = dataset(tables={"day": pd.concat([rows, table(agent="a_s1", y=9.0)])})
    convert(ConversionSettings(found, tmp_path / "cache", progress=False))
    written = pd.read_feather(next(tmp_path.glob("cache/csv/day/agent_data*.feather")))
    place = written.groupby("agent_id")["y"].agg(["min", "max"]).round(6)
    assert place.to_dict("index") == {
        "a": {"min": 1.0, "max": 1.0},
        "a_s1": {"min": 9.0, "max": 9.0},
        "a_s2": {"min": 1.0, "max": 1.0},
    }


def test_scenes_of_a_recording_stay_in_one_split(dataset):
    rows = pd.concat(
        [table(place=f"p{n}", ride=f"r{n // 3}", agent=n) for n in range(18)], ignore_index=True
    )
    columns = TableColumns(scene="place", recording="ride")
    scenes = dataset(tables={"all": rows}, columns=columns).scenes()
    assert len(scenes) == 18
    for number in range(6):
        of_one = {(scene.split, scene.recording) for scene in scenes[3 * number : 3 * number + 3]}
        assert [recording for _, recording in of_one] == [f"r{number}"]
    assert {scene.split for scene in scenes} == {"train", "val", "test"}


def test_rows_without_a_scene_are_counted_and_the_others_keep_their_names(dataset, tmp_path):
    rows = pd.concat([table(place=place) for place in (1, 2, 3, np.nan)])
    found = dataset(tables={"all": rows}, columns=TableColumns(scene="place"))
    report = convert(ConversionSettings(found, tmp_path / "cache", progress=False))
    assert [scene.name for scene in report.scenes if scene.usable] == ["all_1", "all_2", "all_3"]
    assert {scene.split for scene in report.scenes if scene.usable} == {"train", "val", "test"}
    assert report.rejected_by_reason == {RejectReason.NO_SCENE: 1}
    (refused,) = [item for scene in report.scenes for item in scene.rejected]
    assert "`scene` must have a name" in refused["detail"]
    assert "none in 120 rows" in refused["detail"]


def test_a_file_of_many_scenes_is_hashed_once(dataset, monkeypatch):
    rows = pd.concat([table(place=f"p{n}") for n in range(9)])
    found = dataset(tables={"all": rows}, columns=TableColumns(scene="place"))
    read_bytes, read_files = Path.read_bytes, []
    monkeypatch.setattr(
        Path, "read_bytes", lambda path: read_files.append(path.name) or read_bytes(path)
    )
    assert len(found.scenes()) == 9
    assert read_files == ["all.csv"]


@pytest.mark.parametrize("stem", ["2024.05.01", "v1.0/day"])
def test_dots_in_a_path_are_part_of_the_name(dataset, stem):
    names = [scene.name for scene in dataset(tables={stem: table()}).scenes()]
    assert names == [re.sub("[./]", "_", stem)]


def test_a_file_that_repeats_another_stands_in_no_split(dataset, tmp_path):
    tables = {name: table(y=float(name == "c")) for name in "abcd"} | {"e": table(y=2.0)}
    report = convert(ConversionSettings(dataset(tables=tables), tmp_path / "cache", progress=False))
    kept = {scene.name: scene.split for scene in report.scenes if scene.usable}
    assert set(kept) == {"a", "c", "e"}
    assert set(kept.values()) == {"train", "val", "test"}
    assert report.rejected_by_reason == {RejectReason.CONTAINED: 2}
