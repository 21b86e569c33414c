"""Tables beside recordings: numbers by name, and one complaint for whatever is wrong."""

import gzip
import math

import pytest

from data_converters.csv_table import read_by_name, read_numbers
from data_converters.errors import ConversionError, TrackError


@pytest.fixture
def table(tmp_path):
    def write(text, name="table.csv"):
        path = tmp_path / name
        content = text.encode() if isinstance(text, str) else text
        path.write_bytes(gzip.compress(content) if name.endswith("gz") else content)
        return path

    return write


@pytest.mark.parametrize("name", ["table.csv", "table.csv.gz"])
def test_columns_come_in_the_order_that_is_asked_for(table, name):
    path = table("x,more,t\n1,a,0\n,b,0.5\n", name)
    found = read_numbers(path, ["t", "x"], path)
    assert list(found) == ["t", "x"]
    assert found["t"].tolist() == [0.0, 0.5]
    assert found["x"][0] == 1.0
    assert math.isnan(found["x"][1])


def test_text_in_the_place_of_a_number_is_none(table):
    path = table("t,x\n0,one\n1,2\n")
    assert read_numbers(path, ["t", "x"], path)["x"].isna().tolist() == [True, False]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("x\n1\n", "no_timestamps"),
        ("t\n1\n", "missing_field"),
        ("", "missing_field"),
        ("t,x\n1,2,3\n", "missing_field"),
        ("t,x\n1,2\n3,4,5\n", "missing_field"),
        (b"t,x\n\xff\xfe,1\n", "missing_field"),
    ],
)
def test_what_is_no_such_table_is_refused_with_a_reason(table, text, reason):
    path = table(text)
    with pytest.raises(TrackError, match="table.csv") as told:
        read_numbers(path, ["t", "x"], path)
    assert told.value.reason == reason
    assert "\n" not in str(told.value)


def test_rows_are_found_by_the_names_in_them(table):
    path = table("clip,part,scale\na,1,0.5\na,2,none\nb,1,2\nb,1,2\n")
    found = read_by_name(path, ["clip", "part"], ["scale"])
    assert found["a_1"] == (0.5,)
    assert math.isnan(found["a_2"][0])
    assert found["b_1"] == (2.0,)


def test_a_name_with_two_meanings_has_none(table):
    [(number,)] = read_by_name(table("clip,scale\na,1\na,2\n"), ["clip"], ["scale"]).values()
    assert math.isnan(number)


def test_a_table_that_is_not_there_has_no_rows(tmp_path):
    assert read_by_name(tmp_path / "none.csv", ["clip"], ["scale"]) == {}


@pytest.mark.parametrize("text", ["clip\na\n", ""])
def test_a_table_without_its_columns_is_no_fault_of_a_track(table, text):
    with pytest.raises(ConversionError, match="table.csv") as told:
        read_by_name(table(text), ["clip"], ["scale"])
    assert not isinstance(told.value, TrackError)
