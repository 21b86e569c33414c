"""Other recordings do not take the place of those that a cache holds under the same name."""

import json
import re
import shutil

import pytest

from data_converters import ConversionError, ConversionSettings, TableDataset, convert
from dmmv_conventions.cache import read_state
from tests.data_converters.synthetic import table


@pytest.fixture
def convert_from(tmp_path):
    """Convert the tables of a folder, which are written unless they are there."""

    def run(folder, *stems, **options):
        for stem in stems:
            (tmp_path / folder).mkdir(exist_ok=True)
            table(y=float(len(stem))).to_csv(tmp_path / folder / f"{stem}.csv", index=False)
        dataset = TableDataset(tmp_path / folder)
        convert(ConversionSettings(dataset, tmp_path / "cache", progress=False, **options))
        return {scene["name"] for scene in read_state(tmp_path / "cache", "csv")["scenes"]}

    return run


def test_recordings_of_another_folder_are_refused_and_both_folders_named(convert_from, tmp_path):
    convert_from("first", "monday")
    before = (tmp_path / "cache" / "csv" / "cache.json").read_bytes()
    both = f"{re.escape(str(tmp_path / 'first'))}.*{re.escape(str(tmp_path / 'second'))}"
    with pytest.raises(ConversionError, match=f"`root` must.*{both}.*replace=true"):
        convert_from("second", "tuesday")
    assert (tmp_path / "cache" / "csv" / "cache.json").read_bytes() == before


def test_replace_puts_them_in_the_place_of_the_others(convert_from, tmp_path):
    convert_from("first", "monday")
    assert convert_from("second", "tuesday", replace=True) == {"tuesday"}
    origin = json.loads((tmp_path / "cache" / "csv" / "origin.json").read_text())
    assert origin["root"] == str(tmp_path / "second")
    assert convert_from("second") == {"tuesday"}


def test_a_moved_folder_is_the_same(convert_from, tmp_path):
    convert_from("first", "monday", "tuesday")
    shutil.move(tmp_path / "first", tmp_path / "elsewhere")
    assert convert_from("elsewhere") == {"monday", "tuesday"}
    # from here on this is where they are, so that more may come
    assert convert_from("elsewhere", "wednesday") == {"monday", "tuesday", "wednesday"}


def test_a_folder_may_grow_and_be_reached_by_a_link(convert_from, tmp_path):
    convert_from("first", "monday")
    (tmp_path / "link").symlink_to(tmp_path / "first")
    assert convert_from("link", "tuesday") == {"monday", "tuesday"}


@pytest.mark.parametrize("content", [None, "{", "[]"])
def test_a_cache_that_does_not_say_where_it_came_from_is_converted_anew(
    convert_from, tmp_path, content
):
    convert_from("first", "monday")
    origin = tmp_path / "cache" / "csv" / "origin.json"
    origin.unlink()
    if content is not None:
        origin.write_text(content)
    assert convert_from("second", "tuesday") == {"tuesday"}
