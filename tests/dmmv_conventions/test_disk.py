"""Files that are written all or nothing, and a full disk told from other failures."""

import errno

import pytest

from dmmv_conventions.disk import disk_is_full, replacing


@pytest.mark.parametrize(
    ("number", "full"),
    [
        *[(number, True) for number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)],
        *[(number, False) for number in (errno.EIO, errno.EACCES)],
    ],
)
def test_no_space_and_no_quota_are_a_full_disk(number, full):
    assert disk_is_full(OSError(number, "failed")) == full


def test_what_is_written_takes_the_place_of_the_file(tmp_path):
    path = tmp_path / "new" / "table.csv"
    for text in ("old", "new"):
        with replacing(path, ".part.csv") as unfinished:
            assert unfinished.name == "table.csv.part.csv"
            unfinished.write_text(text)
        assert path.read_text() == text
        assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("failure", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt()])
@pytest.mark.parametrize("begun", [True, False])
def test_a_failure_leaves_the_old_file_and_nothing_else(failure, begun, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("old")

    def write():
        with replacing(path) as unfinished:
            if begun:
                unfinished.write_text("half of the n")
            raise failure

    with pytest.raises(type(failure)):
        write()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
