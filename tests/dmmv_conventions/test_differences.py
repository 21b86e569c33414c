"""Configurations of two runs differ in what decides their results."""

import re

from dmmv_conventions.differences import differences, first_difference


def test_all_settings_that_differ_are_told_outer_ones_first():
    before, now = {"a": {"b": 1, "c": 2}, "d": 3}, {"a": {"b": 1, "c": 4}, "e": 5}
    told = [("d", 3, None), ("e", None, 5), ("a.c", 2, 4)]
    assert list(differences(before, now)) == told


def test_the_outermost_setting_that_differs_is_named():
    before, now = {"a": {"b": {"c": 1}}, "d": {"e": 2}}, {"a": {"b": {"c": 2}}, "d": {"e": 3}}
    assert first_difference(before, now) == ("d.e", 2, 3)
    assert first_difference({"a": 1}, {"a": 1, "b": None, "c": 2}) == ("c", None, 2)
    assert first_difference(before, before) is None


def test_a_moved_folder_is_no_difference_and_neither_is_what_is_set_apart():
    before, now = ({"out": out, "log": f"{out}/log", "seen": out} for out in ("/one", "/two"))
    assert first_difference(before, now, re.compile("out")) is None
    assert first_difference(before, now | {"seen": "no"}, re.compile("out|seen")) is None
