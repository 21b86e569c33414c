"""Tables beside a sequence: their order, and columns of one kind."""

import json

import pandas as pd
import pytest
from trajdata.maps.traffic_light_status import TrafficLightStatus

from data_converters import TrackError
from data_converters.imptc.context import read_context, read_table, signals_per_step

START_US = 1_679_472_905_000_000


@pytest.fixture
def told(tmp_path):
    """The table of these entries, which begin a second after the scene and are a second apart."""

    def build(*entries):
        keyed = {str(START_US + 1_000_000 * (n + 1)): entry for n, entry in enumerate(entries)}
        path = tmp_path / "weather.json"
        path.write_text(json.dumps({"weather_data": dict(reversed(keyed.items()))}))
        return read_table(path, "weather_data", START_US)

    return build


def test_entries_are_in_the_order_of_time(told):
    table = told({"rain": 0.0}, {"rain": 0.5}, {"rain": 2.0})
    assert table["time_s"].tolist() == [1.0, 2.0, 3.0]
    assert table["rain"].tolist() == [0.0, 0.5, 2.0]
    assert table.index.tolist() == [0, 1, 2]


@pytest.mark.parametrize("count", [2, 40])
def test_entries_of_one_time_stay_in_the_order_of_the_file(told, count) -> None:
    times = [str(START_US + 1_000_000 * (number // 2)) for number in range(count)]
    table = told(*({"ts": time, "entry": number} for number, time in enumerate(times)))
    for _, together in table.groupby("time_s"):
        first, second = together["entry"]
        assert first == second + 1  # the file holds them from the last to the first


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([1, 2], [1, 2]),
        (["wet", None], ["wet", None]),
        (["wet", 1], ["wet", "1"]),
        ([{"a": 1}, [2]], ["{'a': 1}", "[2]"]),
    ],
)
def test_values_of_several_kinds_become_texts(told, values, expected):
    assert told(*({"road": value} for value in values))["road"].tolist() == expected


@pytest.mark.parametrize("content", [{}, {"weather_data": {}}])
def test_a_file_without_entries_is_no_table(tmp_path, content):
    path = tmp_path / "weather.json"
    assert read_table(path, "weather_data", 0) is None
    path.write_text(json.dumps(content))
    assert read_table(path, "weather_data", 0) is None


@pytest.mark.parametrize(
    "content", [[], "rain", {"weather": {}}, {"weather_data": [{"ts": START_US}]}]
)
def test_entries_in_another_place_or_form_are_told(tmp_path, content):
    path = tmp_path / "weather_data.json"
    path.write_text(json.dumps(content))
    with pytest.raises(TrackError, match="`weather_data` must be an object, .*weather_data.json"):
        read_table(path, "weather_data", 0)
    assert read_context(tmp_path, 0) == ({}, 1)


def test_an_entry_does_not_tell_the_time_of_the_table(told):
    assert told({"time_s": "noon", "rain": 0.5}).to_dict("list") == {"time_s": [1.0], "rain": [0.5]}


@pytest.mark.parametrize("entry", [{}, {"k7": 4}])
def test_lights_of_no_known_group_are_no_signals(told, entry) -> None:
    assert signals_per_step(told(entry), 9, 0.1) is None


@pytest.mark.parametrize("step", [0, 3, 6, 7])
@pytest.mark.parametrize(
    ("code", "name"),
    [
        *((2, "UNKNOWN"), (4, "GREEN"), (10, "RED"), (11, "NO_DATA"), (20, "UNKNOWN"), (30, "RED")),
        *(("10", "RED"), (10.0, "RED"), (5, "UNKNOWN"), ("off", "UNKNOWN")),
    ],
)
def test_a_state_recorded_at_a_step_holds_from_that_step_on(step, code, name) -> None:
    lights = pd.DataFrame({"time_s": [step / 10], "k1": [code]})
    found = signals_per_step(lights, 9, 0.1).loc["k1", "status"].tolist()
    before, after = TrafficLightStatus.NO_DATA, TrafficLightStatus[name]
    assert found == [before] * step + [after] * (9 - step)
