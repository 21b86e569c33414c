"""Scenes have names that are unique and can be those of folders."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_converters.recordings import LONGEST_NAME, scene_names

KEYS = st.text(st.sampled_from("ab/-_. \x00ü") | st.characters(), min_size=1, max_size=200)


@given(st.lists(KEYS, unique=True))
def test_names_of_scenes_are_unique_and_plain(keys):
    names = scene_names(keys)
    assert list(names) == keys
    assert len(set(names.values())) == len(keys)
    for name in names.values():
        assert re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.]*", name)
        assert len(name) <= LONGEST_NAME


@pytest.mark.parametrize(
    ("key", "name"),
    [("cyclists/moving/17", "cyclists_moving_17"), ("2023-05-04", "2023_05_04"), ("a.1", "a.1")],
)
def test_a_plain_key_stays_readable(key, name):
    assert scene_names([key]) == {key: name}


def test_a_name_depends_on_nothing_but_its_key_unless_it_is_taken():
    alone, among = scene_names(["ü"])["ü"], scene_names(["a", "ü", "b"])["ü"]
    assert alone == among
    assert scene_names(["a/b", "a-b"])["a/b"] == "a_b"
