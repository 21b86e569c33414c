"""Arrays on disk: what is damaged is told by its path, whichever part of the file is hit."""

import numpy as np
import pytest

from dmmv_conventions.archives import opened_arrays


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    """A file of two arrays."""
    file = tmp_path_factory.mktemp("arrays") / "whole.npz"
    np.savez_compressed(file, first=np.arange(50.0), second=np.random.default_rng(0).random(50))
    return file.read_bytes()


def first_of(file):
    with opened_arrays(file) as stored:
        return stored["first"]


def test_whole_arrays_are_read(content, tmp_path):
    (tmp_path / "arrays.npz").write_bytes(content)
    np.testing.assert_array_equal(first_of(tmp_path / "arrays.npz"), np.arange(50.0))


def test_a_file_that_is_cut_off_is_told_wherever_it_ends(content, tmp_path):
    for length in range(0, len(content), 37):
        (tmp_path / "arrays.npz").write_bytes(content[:length])
        with pytest.raises(ValueError, match=r"`file` must hold arrays .* in .*arrays.npz"):
            first_of(tmp_path / "arrays.npz")


def test_a_changed_bit_is_told_or_changes_nothing(content, tmp_path):
    told = []
    for place in range(0, len(content), 3):
        changed = bytearray(content)
        changed[place] ^= 1 << place % 8
        (tmp_path / "arrays.npz").write_bytes(changed)
        try:
            np.testing.assert_array_equal(first_of(tmp_path / "arrays.npz"), np.arange(50.0))
        except ValueError as error:
            told.append(str(error))
    assert len(told) > len(content) / 6
    assert all(each.startswith("`file` must hold arrays") for each in told)


def test_an_absent_array_and_an_absent_file_are_told(content, tmp_path):
    (tmp_path / "arrays.npz").write_bytes(content)
    with (
        pytest.raises(ValueError, match="third"),
        opened_arrays(tmp_path / "arrays.npz") as stored,
    ):
        stored["third"]
    with pytest.raises(ValueError, match="absent.npz"):
        first_of(tmp_path / "absent.npz")
