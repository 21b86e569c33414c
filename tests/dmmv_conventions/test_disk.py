"""Telling a full disk from other failures."""

import errno

import pytest

from dmmv_conventions.disk import disk_is_full


@pytest.mark.parametrize(
    ("number", "full"),
    [(errno.ENOSPC, True), (errno.EDQUOT, True), (errno.EIO, False), (errno.EACCES, False)],
)
def test_no_space_and_no_quota_are_a_full_disk(number, full):
    assert disk_is_full(OSError(number, "failed")) == full
