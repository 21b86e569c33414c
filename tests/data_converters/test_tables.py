"""Own tables: columns, units, types, scenes, faults, and the example of the README."""

import gzip
import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import OmegaConf

import diffstack_mmv.commands.cli  # noqa: F401  registers the resolvers
from data_converters import (
    ConversionError,
    ConversionSettings,
    Mode,
    RecordingSplit,
    RejectReason,
    TableColumns,
    TableDataset,
    TableUnits,
    convert,
)
from data_converters.tables.units import Plausibility
from tests.data_converters.synthetic import TABLE_TIME_S as TIME_S
from tests.data_converters.synthetic import first_scene, table

ROOT = Path(__file__).resolve().parents[2]
UNITS = {
    "milliseconds": (TableUnits(time="ms"), {"time": 1e3 * TIME_S}),
    "date and time": (
        TableUnits(time="iso"),
        {"time": [f"2026-05-04T12:00:{second:09.6f}" for second in TIME_S]},
    ),
    "centimetres": (TableUnits(length="cm"), {"x": 400.0 * TIME_S, "y": 100.0}),
    "a picture": (TableUnits(y_down=True), {"y": -1.0}),
}


@pytest.mark.parametrize(("units", "changes"), UNITS.values(), ids=UNITS)
def test_units_become_si(dataset, units, changes):
    (track,) = first_scene(dataset(tables={"day": table(**changes)}, units=units)).tracks
    np.testing.assert_allclose(track.time_s, TIME_S, atol=1e-6)
    np.testing.assert_allclose(track.position[:, 0], 4.0 * TIME_S, atol=1e-9)
    np.testing.assert_allclose(track.position[:, 1], 1.0)
    assert (track.name, track.mode) == ("7", Mode.SCOOTER)


@pytest.mark.parametrize(
    ("unit", "y_down", "stated", "heading"),
    [
        ("deg", False, 90.0, np.pi / 2.0),
        ("compass_deg", False, 90.0, 0.0),
        ("compass_deg", False, 0.0, np.pi / 2.0),
        ("rad", True, 0.3, -0.3),
        # a compass is read off a picture as it is: north is up
        ("compass_deg", True, 0.0, np.pi / 2.0),
        ("compass_deg", True, 90.0, 0.0),
    ],
)
def test_headings_are_turned_counter_clockwise_from_east(dataset, unit, y_down, stated, heading):
    columns, units = TableColumns(heading="face"), TableUnits(angle=unit, y_down=y_down)
    way = 4.0 * TIME_S * (-1.0 if y_down else 1.0)
    path = {"x": 4.0 * TIME_S * np.cos(heading), "y": np.sin(heading) * way}
    found = dataset(tables={"d": table(face=stated, **path)}, columns=columns, units=units)
    (track,) = first_scene(found).tracks
    np.testing.assert_allclose(track.heading, heading, atol=1e-12)


MISTAKES = {
    "a column": ({}, {"columns": TableColumns(time="t")}, r"`columns\.time` must.*'t'.*time, x, y"),
    "a control": (
        {},
        {"columns": TableColumns(controls={"steer": "delta"})},
        r"`columns\.controls\.steer`.*'delta'.* Give \+data\..*NAME, or leave it out\.$",
    ),
    "milliseconds": ({"time": 1e3 * TIME_S}, {}, "`rate`.*0.01 Hz.*units.time"),
    "centimetres": ({"x": 400.0 * TIME_S}, {}, "`speed`.*400 m/s.*units.length"),
    "degrees": (
        {"face": 30.0},
        {"columns": TableColumns(heading="face")},
        "6.283 rad.*30 in.*face.*units.angle",
    ),
    "a compass": (
        {"face": 90.0},
        {"columns": TableColumns(heading="face"), "units": TableUnits(angle="deg")},
        "course.*90 deg.*face.*units.angle",
    ),
    "km/h": ({"v": 14.4}, {"columns": TableColumns(speed="v")}, "speed.*3.6 times.*v.*units.speed"),
    "longitude": (
        {"x": 8.4 + 5e-5 * TIME_S, "y": 49.0},
        {},
        "`position` must be in metres.*longitude",
    ),
    "metres as millimetres": (
        {"v": 4.0},
        {"columns": TableColumns(speed="v"), "units": TableUnits(length="mm")},
        "speed.*e[+]03 times as much in column v.*check the units of x, y",
    ),
    "the rate": ({}, {"plausible": Plausibility(rate_hz=25.0)}, "`rate` must be 25 Hz.*10 Hz"),
}


@pytest.mark.parametrize(("changes", "options", "says"), MISTAKES.values(), ids=MISTAKES)
def test_a_wrong_setting_is_told_with_what_to_change(dataset, changes, options, says):
    with pytest.raises(ConversionError, match=says):
        first_scene(dataset(tables={"day": table(**changes)}, **options))


BELIEVED = {
    "who stands": {"x": 8.4, "v": 0.0},
    "who trembles": {"x": 8.4 + 1e-4 * np.sin(37.0 * TIME_S), "v": 0.0},
    "a pedestrian who walks backwards": {
        "x": TIME_S,
        "v": 1.0,
        "face": np.pi,
        "type": "pedestrian",
    },
    "one heading of nonsense": {"face": np.where(TIME_S == 0.0, 999.0, 0.0)},
    "one place that is endless": {
        "x": np.where(TIME_S == 0.0, np.inf, 4.0 * TIME_S),
        "agent": 7 + (TIME_S > 0.0),
    },
    "no speed and no heading": {"v": np.nan, "face": np.nan},
}


@pytest.mark.parametrize("changes", BELIEVED.values(), ids=BELIEVED)
def test_what_can_be_is_believed(dataset, changes):
    columns = TableColumns(heading="face", speed="v")
    rows = table(**({"face": 0.0, "v": 4.0} | changes))
    found = dataset(tables={"day": rows}, columns=columns)
    assert len(first_scene(found, strict=False).tracks) == 1


# their own differences at 25 Hz, of places with noise of 2 cm; the noise of a speedometer alone
@pytest.mark.parametrize(
    ("pace", "noise_m", "noise_mps"), [(0.3, 0.02, 0.0), (0.0, 0.0, 0.5)], ids=["walk", "stand"]
)
def test_noisy_speeds_of_the_slow_are_believed(dataset, pace, noise_m, noise_mps):
    random = np.random.default_rng(1)
    time_s = np.arange(0.0, 20.0, 0.04)
    rows = []
    for agent in range(3):
        x = pace * time_s + random.normal(0.0, noise_m, len(time_s))
        y = 2.0 * agent + random.normal(0.0, noise_m, len(time_s))
        differences = np.hypot(np.gradient(x, time_s), np.gradient(y, time_s))
        v = np.abs(differences + random.normal(0.0, noise_mps, len(time_s)))
        path = {"time": time_s, "x": x, "y": y, "v": v}
        rows.append(pd.DataFrame({**path, "agent": agent, "type": "pedestrian"}))
    found = dataset(tables={"day": pd.concat(rows)}, columns=TableColumns(speed="v"))
    assert len(first_scene(found).tracks) == 3


def test_a_table_without_a_place_is_no_fault_of_the_units(dataset):
    columns = TableColumns(heading="face", speed="v")
    rows = table(face=0.0, v=4.0, x=np.nan)
    raw = first_scene(dataset(tables={"day": rows}, columns=columns), strict=False)
    assert [item.reason for item in raw.rejected] == [RejectReason.NOT_FINITE]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"called": "my-scooters"}, "`name` must consist of letters"),
        (
            {"types": {"roller": "hovercraft"}},
            "`types.roller` must be one of.*'hovercraft'. Choose",
        ),
        ({"types": {"roller": "scoter"}}, "`types.roller` must be .*Did you mean 'scooter'[?]"),
        ({"mode": "bicyle"}, "`mode` must be one of .*'bicyle'. Did you mean 'bicycle'[?]"),
        ({"columns": TableColumns(type=None)}, "`mode` must be given"),
    ],
)
def test_an_impossible_description_is_refused(tmp_path, options, says):
    with pytest.raises(ConversionError, match=says):
        TableDataset(tmp_path, **options)


@pytest.mark.parametrize("unit", ["time", "length", "angle", "speed"])
def test_an_unknown_unit_is_refused(unit):
    with pytest.raises(ConversionError, match=rf"`units\.{unit}` must be one of"):
        TableUnits(**{unit: "furlong"})


def test_a_packed_copy_of_a_table_is_left_out_and_so_is_in_no_other_split(dataset, tmp_path):
    own = dataset(tables={name: table(y=2.0 * n) for n, name in enumerate("abc")})
    before = own.scenes()
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress((tmp_path / "a.csv").read_bytes()))
    own = TableDataset(tmp_path)
    copy = next(scene for scene in own.scenes() if scene not in before)
    raw = own.read(copy, 0.1, strict=True)
    assert raw.tracks == []
    assert [each.reason for each in raw.rejected] == [RejectReason.CONTAINED]


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        ({"x": "west"}, RejectReason.NOT_FINITE),
        ({"type": "horse"}, RejectReason.UNKNOWN_CLASS),
        ({"time": 1.0}, RejectReason.REPEATED_TIMESTAMPS),
    ],
)
def test_bad_rows_cost_their_agent_alone(dataset, bad, reason):
    rows = pd.concat([table(), table(agent=8, **bad)])
    raw = first_scene(dataset(tables={"day": rows}), strict=False)
    assert [(item.track, item.reason) for item in raw.rejected] == [("8", reason)]
    assert [track.name for track in raw.tracks] == ["7"]


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        (
            pd.concat([table(), table(time=9000.0 + TIME_S)]),
            "at most 7200 s for one agent.*trips apart",
        ),
        (
            table(time=6.0 * TIME_S),
            "samples are farther apart than `max_gap_s` = 0.5 s, raise that",
        ),
    ],
    ids=["two trips", "slow samples"],
)
def test_a_remedy_names_what_helps(dataset, tmp_path, rows, says):
    found = dataset(tables={"day": rows})
    with pytest.raises(ConversionError, match=says):
        convert(ConversionSettings(found, tmp_path / "cache", progress=False))


def test_two_riders_of_one_name_are_not_made_one(dataset):
    rows = pd.concat([table(), table(y=1.5), table(agent=8), table(agent=8, y=9.0)])
    raw = first_scene(dataset(tables={"day": rows}), strict=False)
    assert [track.name for track in raw.tracks] == ["7"]
    (rejection,) = raw.rejected
    assert (rejection.track, rejection.reason) == ("8", RejectReason.TWO_PLACES)
    assert "`agent` must be in one place at a time, but got 'two 8 m apart" in rejection.detail


@pytest.mark.parametrize("columns", [TableColumns(), TableColumns(heading="face")])
@pytest.mark.parametrize(("unit", "told"), [("m", False), ("cm", True), ("mm", True)])
def test_a_small_unit_is_told_where_nobody_moves(dataset, tmp_path, caplog, columns, unit, told):
    rows, units = table(face=0.0), TableUnits(length=unit)
    found = dataset(tables={"day": rows}, columns=columns, units=units)
    convert(ConversionSettings(found, tmp_path / "cache", progress=False))
    says = f"Positions are read as {unit} (data.units.length): check their unit."
    assert (says in caplog.text) == told


def test_a_broken_file_is_counted_and_the_others_kept(dataset, tmp_path):
    found = dataset(tables={"a": table(), "b": table(y=2.0)})
    (tmp_path / "c.csv").write_text("")
    report = convert(ConversionSettings(found, tmp_path / "cache", progress=False))
    assert report.rejected_by_reason == {RejectReason.MISSING_FIELD: 1}


def test_a_split_that_lost_all_its_recordings_is_told(dataset, tmp_path, caplog):
    tables = {"a": table(), "b": table(y=2.0), "c": table(y=3.0), "d": table(x=np.nan)}
    given = RecordingSplit(given={"a": "train", "b": "train", "c": "val", "d": "test"})
    found = dataset(tables=tables, split=given)
    convert(ConversionSettings(found, tmp_path / "cache", progress=False))
    (told,) = [each.getMessage() for each in caplog.records if each.levelname == "WARNING"]
    assert "split 'test' holds no agent" in told
    assert ": d. Correct" in told


def converted(tmp_path, *words):
    """The report of a conversion as the command line is given it."""
    with initialize_config_dir(str(ROOT / "configs"), version_base="1.3"):
        folders = [f"data.root={tmp_path}", f"data.cache={tmp_path / 'cache'}", "out=out"]
        config = compose("convert", ["data=csv", *folders, *words])
    OmegaConf.resolve(config)
    found = instantiate(config.data.recordings)
    return convert(ConversionSettings(found, Path(config.data.cache), progress=False))


def test_coordinates_of_a_map_need_a_wider_limit(dataset, tmp_path):
    dataset(tables={"day": table(x=5e5 + 4.0 * TIME_S, y=5.5e6)})
    with pytest.raises(ConversionError, match=r"data\.recordings\.limits\.coordinate_m"):
        converted(tmp_path)
    assert (tmp_path / "cache" / "conversion_report.json").is_file()
    report = converted(tmp_path, "data.recordings.limits.coordinate_m=1e7")
    assert report.totals()["scenes"] == 1


def test_positions_count_from_the_origin(dataset):
    units = TableUnits(length="km", y_down=True, origin_m=(5e5, -5.5e6))
    far = table(x=500.0 + 4e-3 * TIME_S, y=5499.999)
    (track,) = first_scene(dataset(tables={"day": far}, units=units)).tracks
    np.testing.assert_allclose(track.position[:, 0], 4.0 * TIME_S, atol=1e-6)
    np.testing.assert_allclose(track.position[:, 1], 1.0, atol=1e-6)


def test_the_origin_that_a_message_names_brings_a_map_near(dataset, tmp_path):
    dataset(tables={"day": table(x=5e5 + 4.0 * TIME_S, y=5.5e6)})
    with pytest.raises(ConversionError, match="origin_m by") as told:
        converted(tmp_path)
    origin = re.findall(r"origin_m by (\[.*?\])", str(told.value))[0]
    assert converted(tmp_path, f"data.units.origin_m={origin}").totals()["scenes"] == 1


@pytest.mark.parametrize("origin", [(1.0,), (1.0, float("nan")), ("a", 1.0), (1.0, 2.0, 3.0)])
def test_an_origin_is_two_numbers(origin):
    with pytest.raises(ConversionError, match=r"`units\.origin_m` must be two numbers"):
        TableUnits(origin_m=origin)


def test_files_are_recordings_whose_split_can_be_given(dataset):
    given = RecordingSplit(given={"a_1": "test", "b": "test", "sub_c": "train"})
    tables = {"a-1": table(), "b": table(), "sub/c": table()}
    scenes = dataset(tables=tables, split=given).scenes()
    assert {scene.name: scene.split for scene in scenes} == dict(given.given)


@pytest.mark.parametrize(
    ("mark", "output"),
    [
        ("cache/conversion_report.json", "cache/exports/e/samples.parquet"),
        ("exports/e/export.json", "exports/e/samples.parquet"),
        ("cache/mine/cache.json", "cache/mine/day/controls.parquet"),
        ("runs/one/.hydra/config.yaml", "runs/one/csv/metrics.csv"),
        ("reports/one/config.yaml", "reports/one/samples.parquet"),
        ("cache/.converting_mine_0/x", "cache/.converting_mine_0/day/controls.parquet"),
    ],
)
def test_what_commands_wrote_below_the_tables_is_no_recording(dataset, tmp_path, mark, output):
    for path in (tmp_path / mark, tmp_path / output):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("out: here\n")
    found = dataset(tables={"a": table(), "sub/b": table()})
    assert [scene.name for scene in found.scenes()] == ["a", "sub_b"]


@pytest.mark.parametrize(
    ("place", "content", "stem"),
    [("sub/config.yaml", "camera: left\n", "sub/b"), ("config.yaml", "out: .\n", "a")],
    ids=["of a recorder", "of the folder itself"],
)
def test_a_configuration_that_marks_no_output_hides_no_table(
    dataset, tmp_path, place, content, stem
):
    (tmp_path / place).parent.mkdir(exist_ok=True)
    (tmp_path / place).write_text(content)
    assert len(dataset(tables={stem: table()}).scenes()) == 1


@pytest.mark.parametrize(
    ("missing", "held", "unusable"),
    [([5], 1, 0), ([5, 6, 7], 3, 0), ([0], 0, 1), (range(9, 20), 0, 1)],
)
def test_a_heading_that_is_missing_for_a_moment_is_held(dataset, missing, held, unusable):
    way = {"x": 0.0, "y": 4.0 * TIME_S}
    face = np.where(np.isin(np.arange(len(TIME_S)), list(missing)), np.nan, 0.4 * np.pi)
    columns = TableColumns(heading="face")
    raw = first_scene(dataset(tables={"d": table(face=face, **way)}, columns=columns))
    assert raw.notes["headings_held"] == held
    assert raw.notes["agents_with_unusable_headings"] == unusable
    heading = raw.tracks[0].heading
    assert (heading is None) == bool(unusable)
    assert heading is None or np.allclose(heading, 0.4 * np.pi)


@pytest.mark.parametrize("size", [-1.0, 0.0, 180.0])
def test_a_size_that_cannot_be_costs_its_agent_alone(dataset, tmp_path, size):
    rows = pd.concat([table(long=1.3), table(agent=8, long=size)])
    found = dataset(tables={"d": rows}, columns=TableColumns(length="long"))
    report = convert(ConversionSettings(found, tmp_path / "cache", progress=False))
    (refused,) = report.scenes[0].rejected
    assert (refused["track"], refused["reason"]) == ("8", RejectReason.EXTENT)
    assert f"`length` must be above 0 and at most 30 m, but got '{size:g}'" in refused["detail"]


def test_sizes_and_one_mode_for_all(dataset):
    columns = TableColumns(type=None, agent=None, length="long")
    found = dataset(tables={"d": table(long=1.3)}, columns=columns, mode="scooter")
    (track,) = first_scene(found).tracks
    assert (track.extent.length, track.extent.width, track.mode) == (1.3, 0.6, Mode.SCOOTER)


def test_the_example_of_the_readme_runs(tmp_path, monkeypatch):
    text = (ROOT / "data_converters" / "README.md").read_text().partition("## Your own tables")[2]
    script = re.search(r"```python\n(.*?)```", text, re.DOTALL)[1]
    given = re.search(r"```bash\n(.*?)```", text, re.DOTALL)[1].replace("\\\n", " ")
    assert len(script.splitlines()) + len(given.splitlines()) <= 20
    monkeypatch.chdir(tmp_path)
    exec(compile(script, "README.md", "exec"), {})  # noqa: S102
    words = shlex.split(given)
    assert words[:2] == ["python", "scripts/convert.py"]
    with initialize_config_dir(str(ROOT / "configs"), version_base="1.3"):
        config = compose("convert", [*words[2:], "out=out"])
    OmegaConf.resolve(config)
    dataset = instantiate(config.data.recordings)
    settings = ConversionSettings(dataset, Path(config.data.cache), progress=False, strict=True)
    report = convert(settings)
    assert sum(sum(agents.values()) for agents in report.agents().values()) == 6
    controls = pd.read_parquet(next(tmp_path.glob("cache/my_scooters/*/controls.parquet")))
    assert set(controls.columns) == {"agent_id", "time_s", "steer"}
