"""Modes: numbers that caches keep, and names."""

import pickle

import pytest
from trajdata.data_structures.agent import AgentType

from dmmv_conventions.modes import Mode

NUMBERED = [
    "unknown",
    "car",
    "pedestrian",
    "bicycle",
    "motorcycle",
    "scooter",
    "skateboard",
    "cart",
    "stroller",
    "wheelchair",
    "truck",
]


@pytest.mark.parametrize("agent_type", list(AgentType))
def test_modes_begin_with_the_values_of_trajdata(agent_type):
    names = {"VEHICLE": "CAR"}
    assert Mode(agent_type.value).name == names.get(agent_type.name, agent_type.name)


@pytest.mark.parametrize(("number", "label"), enumerate(NUMBERED))
def test_modes_are_numbered_as_promised(number, label):
    assert Mode(number).label == label
    assert len(Mode) == len(NUMBERED)


@pytest.mark.parametrize("name", ["Scooter", "scooter", "SCOOTER"])
def test_a_mode_is_found_by_name_in_any_case(name):
    assert Mode.named(name) is Mode.SCOOTER


@pytest.mark.parametrize("name", ["bike", "vehicle", ""])
def test_an_unknown_name_lists_the_known_ones(name):
    with pytest.raises(ValueError, match=f"`mode` must be one of bicycle, .* but got '{name}'"):
        Mode.named(name)


def test_a_misspelt_name_is_told_what_was_meant():
    with pytest.raises(ValueError, match="but got 'bicyle'. Did you mean 'bicycle'[?]$"):
        Mode.named("bicyle")


@pytest.mark.parametrize(
    "module", ["dmmv_conventions.modes", "diffstack_mmv.types", "data_converters.modes"]
)
def test_pickles_find_the_modes_wherever_they_once_stood(module):
    assert pickle.loads(f"c{module}\nMode\n(I5\ntR.".encode()) is Mode.SCOOTER
