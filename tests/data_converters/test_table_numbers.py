"""Own tables: how numbers are written, and where one stands that cannot be read."""

import re

import numpy as np
import pandas as pd
import pytest

from data_converters import ConversionError, RejectReason, TableColumns, TableDataset, TableUnits
from tests.data_converters.synthetic import TABLE_TIME_S, first_scene, table

COMMA = TableUnits(decimal="comma")


def written(tmp_path, content, **options):
    (tmp_path / "day.csv").write_bytes(content.encode() if isinstance(content, str) else content)
    return TableDataset(tmp_path, **options)


@pytest.mark.parametrize(
    ("text", "options"),
    [
        (table(agent="0007").to_csv(index=False, sep=";", decimal=","), {"units": COMMA}),
        (table(agent="0007").to_csv(index=False).replace(",", " , "), {}),
    ],
    ids=["decimal commas", "blanks around names"],
)
def test_a_byte_order_mark_and_the_spelling_of_numbers_do_not_matter(tmp_path, text, options):
    (track,) = first_scene(written(tmp_path, text.encode("utf-8-sig"), **options)).tracks
    assert track.name == "0007"
    np.testing.assert_allclose(track.time_s, TABLE_TIME_S, atol=1e-9)
    np.testing.assert_allclose(track.position[:, 0], 4.0 * TABLE_TIME_S, atol=1e-9)


def test_columns_that_differ_by_blanks_alone_are_refused(tmp_path):
    text = table(note=1).to_csv(index=False).replace("note", "x ")
    with pytest.raises(ConversionError, match=r"`header` must name every column once.*\['x'\]"):
        first_scene(written(tmp_path, text))


def test_columns_that_are_not_read_may_have_one_name(tmp_path):
    rows = table(note=1, other=2, gap=3, hole=4).to_csv(index=False)
    text = rows.replace("other", " note").replace("gap", " ").replace("hole", "  ")
    assert len(first_scene(written(tmp_path, text)).tracks) == 1


def test_controls_have_decimal_commas_too(tmp_path):
    text = table(steer=0.25).to_csv(index=False, sep=";", decimal=",")
    columns = TableColumns(controls={"steer": "steer"})
    raw = first_scene(written(tmp_path, text, units=COMMA, columns=columns))
    assert (raw.side_tables["controls"]["steer"] == 0.25).all()


def test_rows_without_a_control_are_counted(tmp_path):
    rows = table(steer=0.25, throttle=1.0)
    rows["steer"] = rows["steer"].astype(object)
    rows.loc[3, "steer"], rows.loc[4, "steer"] = "n/a?", None
    columns = TableColumns(controls={"steer": "steer", "acceleration": "throttle"})
    raw = first_scene(written(tmp_path, rows.to_csv(index=False), columns=columns))
    assert (raw.notes["rows_without_steer"], raw.notes["rows_without_acceleration"]) == (2, 0)


@pytest.mark.parametrize(("mark", "units"), [(",", TableUnits()), (".", COMMA)])
def test_another_decimal_mark_is_told_with_its_setting(tmp_path, mark, units):
    text = table(y=1).to_csv(index=False, sep=";", decimal=mark) + "?;0;1;8;scooter\n"
    setting = "comma" if mark == "," else "point"
    says = rf"`units\.decimal` must.*'0\{mark}0' in .*day\.csv, line 2, column 'time'.*{setting}"
    with pytest.raises(ConversionError, match=says):
        first_scene(written(tmp_path, text, units=units))


def test_text_among_decimal_commas_costs_its_agent_alone(tmp_path):
    text = table().to_csv(index=False, sep=";", decimal=",") + "0,1;1.234;1;8;scooter\n"
    raw = first_scene(written(tmp_path, text, units=COMMA), strict=False)
    assert [track.name for track in raw.tracks] == ["7"]
    assert "got '1.234' in" in raw.rejected[0].detail


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        ("x", "west", r"`x` must be a finite number, but got 'west' in .*line 125, column 'x'"),
        ("y", None, "`y` must be a finite number, but got 'nothing'"),
        ("time", "12:00", "`time` must.*'12:00'.*units.time=iso"),
        ("x", "1,5", "'1,5'"),
    ],
)
def test_what_cannot_be_read_is_told_with_file_line_and_column(dataset, column, value, says):
    bad = table(agent=8).astype({column: object})
    bad.loc[3, column] = value
    raw = first_scene(dataset(tables={"day": pd.concat([table(), bad])}), strict=False)
    (rejection,) = raw.rejected
    assert (rejection.track, rejection.reason) == ("8", RejectReason.NOT_FINITE)
    assert re.search(says, rejection.detail)
    assert [track.name for track in raw.tracks] == ["7"]


@pytest.mark.parametrize(
    ("changes", "columns", "says"),
    [
        ({"face": "12°"}, {"heading": "face"}, "`face` must hold numbers.*'12°' in .*line 2"),
        ({"delta": "left"}, {"controls": {"steer": "delta"}}, "`delta` must hold numbers.*'left'"),
        ({"time": "12:00"}, {}, "`time` must hold numbers.*'12:00'.*units.time=iso"),
    ],
)
def test_a_column_of_text_is_no_column_of_numbers(dataset, changes, columns, says):
    found = dataset(tables={"day": table(**changes)}, columns=TableColumns(**columns))
    with pytest.raises(ConversionError, match=says):
        first_scene(found)


def test_a_column_may_be_empty(dataset):
    found = dataset(tables={"day": table(face=None)}, columns=TableColumns(heading="face"))
    assert first_scene(found).tracks[0].heading is None


def test_a_row_of_a_parquet_file_is_told_by_its_number(tmp_path):
    rows = table()
    rows.loc[3, "x"] = np.inf
    rows.set_index(rows.index % 7).to_parquet(tmp_path / "day.parquet")
    raw = first_scene(TableDataset(tmp_path), strict=False)
    assert "got inf in" in raw.rejected[0].detail
    assert "day.parquet, row 4, column 'x'" in raw.rejected[0].detail


def test_a_date_that_is_none_is_told(dataset):
    times = [f"2026-05-04T12:00:{second:09.6f}" for second in TABLE_TIME_S]
    found = dataset(tables={"day": table(time=["noon", *times[1:]])}, units=TableUnits(time="iso"))
    detail = first_scene(found, strict=False).rejected[0].detail
    assert re.search("must be a date and time such as .* got 'noon' in .*line 2, column", detail)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (table().to_csv(index=False).replace("\n", ",\n").replace("type,", "type"), "`header`"),
        ("time;x;agent;type\n0;1;Jürgen;bike".encode("latin-1"), "Save it as UTF-8"),
        ("time\tx\tagent\ttype\n".encode("utf-16"), "Save it as UTF-8"),
    ],
    ids=["separators at the ends of lines", "Latin-1", "UTF-16"],
)
def test_a_table_that_would_be_misread_is_refused(tmp_path, content, says):
    raw = first_scene(written(tmp_path, content), strict=False)
    assert says in raw.rejected[0].detail


@pytest.mark.parametrize(
    ("unit", "read", "told", "known"),
    [
        ({"speed": "km/h"}, "metres_per_second", 36.0, 10.0),
        ({"speed": "mph"}, "metres_per_second", 100.0, 44.704),
        ({"length": "ft"}, "metres", 3.0, 0.9144),
        ({"length": "mm"}, "metres", 1500.0, 1.5),
        ({"length": "km"}, "metres", 0.2, 200.0),
        ({"time": "ns"}, "seconds", 2.5e9, 2.5),
        ({"angle": "deg"}, "radians", 90.0, np.pi / 2),
        ({"angle": "compass_deg"}, "radians", 90.0, 0.0),
        ({"angle": "compass_deg"}, "radians", 0.0, np.pi / 2),
        ({"angle": "deg", "y_down": True}, "radians", 90.0, -np.pi / 2),
    ],
)
def test_a_number_in_its_unit_is_read_in_si_units(unit, read, told, known) -> None:
    found = getattr(TableUnits(**unit), read)(pd.Series([told]))
    assert found.item() == pytest.approx(known)
