"""What can be wrong with the state of a cache, and what is said about it."""

import json
import re
import shlex

import pytest
from hydra import compose, initialize_config_dir

from data_converters import CacheError
from dmmv_conventions.cache import (
    FORMAT_VERSION,
    STATE_FILE,
    conversion_of,
    read_state,
    staging_folder,
)
from dmmv_conventions.configs import config_folder

STATE = {"format_version": FORMAT_VERSION, "complete": True}


@pytest.fixture
def write(tmp_path):
    """Write a text as the state of the environment "toy"."""

    def to(text):
        (tmp_path / "toy").mkdir()
        (tmp_path / "toy" / STATE_FILE).write_text(text)
        return tmp_path

    return to


def test_a_finished_state_is_read_as_it_was_written(write):
    assert read_state(write(json.dumps(STATE | {"dt_s": 0.1})), "toy") == STATE | {"dt_s": 0.1}


@pytest.mark.parametrize("error", [ValueError, CacheError])
@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("{", "`cache` must have a state in JSON"),
        (json.dumps(STATE | {"format_version": 7}), "`format_version` must be 1, but got 7"),
        (json.dumps({"complete": True}), "`format_version` must be 1, but got None"),
        (json.dumps(STATE | {"complete": False}), "`complete` must be true, but got False"),
    ],
)
def test_a_cache_of_another_state_names_the_file_and_the_remedy(write, text, complaint, error):
    folder = write(text)
    with pytest.raises(error, match=re.escape(complaint)) as caught:
        read_state(folder, "toy", error)
    assert str(folder / "toy" / STATE_FILE) in str(caught.value)
    assert conversion_of("toy", folder) in str(caught.value)


@pytest.mark.parametrize(
    ("name", "found"), [("toy", "an interrupted conversion"), ("other", "no such file")]
)
def test_an_absent_state_is_told_from_an_interrupted_conversion(tmp_path, name, found):
    staging_folder(tmp_path, "toy", "12ab").mkdir()
    with pytest.raises(ValueError, match=f"conversion of '{name}', but got {found} at .* Run"):
        read_state(tmp_path, name)


@pytest.mark.parametrize("text", ["[]", "[" * 100_000, "1"])
def test_a_state_that_is_no_object_is_told(write, text):
    with pytest.raises(ValueError, match="`cache` must have a state in JSON"):
        read_state(write(text), "toy")


@pytest.mark.parametrize(
    ("name", "choice"),
    [
        ("imptc", "data=imptc"),
        ("sdd", "data=sdd"),
        ("csv", "data=csv"),
        ("eth_ucy_zara1", "data=eth_ucy data.held_out=zara1"),
        ("rides", "data=csv data.name=rides"),
    ],
)
def test_the_command_of_a_conversion_makes_the_environment_of_that_name(tmp_path, name, choice):
    told = conversion_of(name, tmp_path / "my cache")
    given = ["data.root=RECORDINGS", f"data.cache={tmp_path}/my cache"]
    assert shlex.split(told) == ["Run", "python", "scripts/convert.py", *choice.split(), *given]
    with initialize_config_dir(str(config_folder()), version_base=None):
        made = compose("convert", [*choice.split(), *given])
    assert (made.data.name, made.data.cache) == (name, f"{tmp_path}/my cache")
