"""Which names data sets can have."""

import re

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from dmmv_conventions.configs import config_folder
from dmmv_conventions.data_names import family_of, require_name_of_converter

CONVERTED = sorted(
    file.stem
    for file in (config_folder() / "data").glob("*.yaml")
    if "\nrecordings:" in file.read_text()
)


def data_of(choice):
    """The part of a configuration that these words choose."""
    with initialize_config_dir(str(config_folder()), version_base=None):
        made = compose("convert", ["data.root=R", "data.cache=C", *f"data={choice}".split()])
    return OmegaConf.to_container(made)["data"]


@pytest.mark.parametrize(
    ("name", "family"),
    [("eth_ucy_eth", "eth_ucy"), ("thab_vru", "thab_vru"), ("csv", "csv"), ("my_own", "my_own")],
)
def test_names_of_one_data_set_are_a_family(name, family):
    assert family_of(name) == family


@pytest.mark.parametrize("script", ["convert", "train"])
def test_commands_refuse_a_name_under_which_nothing_is_converted(refusal, tmp_path, script):
    """What is converted from these recordings lies where no command would look for it."""
    words = "data=sdd", "data.name=mine", f"data.root={tmp_path}", f"data.cache={tmp_path}"
    told = refusal(script, *words, f"out={tmp_path / 'out'}")
    assert "`data.name` must be sdd, as data=sdd is always called, but got 'mine'. Leave it" in told


@pytest.mark.parametrize("choice", [each for each in CONVERTED if each != "csv"])
def test_a_refused_name_is_told_with_that_of_the_converter(choice):
    called = {"eth_ucy": "eth_ucy_${data.held_out}"}.get(choice, choice)
    told = f"must be {called}, as data={choice} is always called, but got 'mine'"
    with pytest.raises(ValueError, match=re.escape(told)):
        require_name_of_converter(data_of(f"{choice} data.name=mine"))


@pytest.mark.parametrize("choice", [*CONVERTED, "csv data.name=mine", "trajdata data.name=mine"])
def test_names_that_a_conversion_can_have_pass(choice):
    require_name_of_converter(data_of(choice))


@pytest.mark.parametrize(
    "data", [None, "x", {}, {"name": "x", "recordings": {"_target_": "my.Set"}}]
)
def test_data_without_a_converter_of_ours_may_have_any_name(data):
    require_name_of_converter(data)
