"""Archives are taken whole or not at all, and nothing in them leads out of their folder."""

import gzip
import io
import tarfile

import pytest

from data_converters.archives import reaches_outside, whole_tar
from data_converters.errors import ConversionError


@pytest.fixture
def archive(tmp_path):
    """Writes a gzipped archive of two files, changed by a function of its bytes."""

    def write(change=lambda content: content, packed=True):
        buffer = io.BytesIO()
        with tarfile.open(fileobj=buffer, mode="w") as tar:
            for name in ("a", "b"):
                tar.addfile(tarfile.TarInfo(name), io.BytesIO())
        content = buffer.getvalue()
        path = tmp_path / "some.tar.gz"
        path.write_bytes(change(gzip.compress(content) if packed else content))
        return path

    return write


@pytest.mark.parametrize("packed", [True, False])
def test_a_whole_archive_is_opened_however_it_is_packed(archive, packed):
    with whole_tar(archive(packed=packed)) as tar:
        assert tar.getnames() == ["a", "b"]


@pytest.mark.parametrize(
    ("packed", "change"),
    [
        (True, lambda content: content[:-4]),  # of the length
        (True, lambda content: content[:-8] + bytes(8)),  # the checksum
        (True, lambda content: content[: len(content) // 2]),
        (False, lambda content: content[:1024]),  # between two files, as tarfile would not see
        (False, lambda content: content[:1024] + b"0" * 1024),
        (True, lambda content: b"no archive"),
        (True, lambda content: b""),
    ],
)
def test_a_damaged_archive_is_refused(archive, packed, change):
    place = archive(change, packed)
    with (
        pytest.raises(ConversionError, match=r"`archive` must be whole.*some\.tar\.gz"),
        whole_tar(place),
    ):
        pass


def test_an_archive_that_unpacks_to_more_than_it_may_is_refused(archive):
    with (
        pytest.raises(ConversionError, match="`archive` must unpack to at most 2048 bytes"),
        whole_tar(archive(), largest=2048),
    ):
        pass


@pytest.mark.parametrize(
    ("name", "outside"),
    [
        ("a/b.csv", False),
        ("a..b/..c.csv", False),
        ("./a.csv", False),
        ("/etc/passwd", True),
        ("../a.csv", True),
        ("a/../../b.csv", True),
        ("a\\..\\..\\b.csv", True),
    ],
)
def test_a_member_that_leads_out_of_its_folder_is_known(name, outside):
    assert reaches_outside(name) == outside
