"""Recordings lie in plain files of a bounded size."""

import gzip
import os

import pytest

from benchmarks.faults.tables import ENDLESS
from data_converters.errors import TrackError
from data_converters.plain_files import require_plain


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz"])
def test_a_file_up_to_the_largest_size_is_taken(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(gzip.compress(b"0" * 99) if name.endswith("gz") else b"0" * 99)
    require_plain(path, 99)
    with pytest.raises(TrackError, match="must have at most 98 bytes"):
        require_plain(path, 98)


@pytest.mark.parametrize("name", ENDLESS)
def test_what_has_no_end_is_refused_at_once(tmp_path, name):
    ENDLESS[name](tmp_path / "1.csv")
    with pytest.raises(TrackError, match="be a plain file|at most") as told:
        require_plain(tmp_path / "1.csv")
    assert told.value.reason == "unreadable_file"


@pytest.mark.parametrize("content", [b"", b"no archive", gzip.compress(os.urandom(9999))[:5000]])
def test_a_broken_archive_is_left_to_its_reader(tmp_path, content):
    (tmp_path / "a.csv.gz").write_bytes(content)
    require_plain(tmp_path / "a.csv.gz")
