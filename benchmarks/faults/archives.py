"""Archives that are cut off, damaged or reach where they should not."""

import gzip
import io
import tarfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from benchmarks.faults.tables import THAB, text, thab_rows
from benchmarks.faults.trial import Result, Trial, converted, each
from data_converters import ConversionSettings, ThabVruDataset, convert
from data_converters.downloading import DownloadError, unpack

GOOD = text(THAB, thab_rows()).encode()
OTHER = text(THAB, thab_rows(5.0)).encode()


def tar_of(*members: tuple[str, bytes | str, bytes]) -> bytes:
    """A tar file of (name, content or target, type)."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as tar:
        for name, content, kind in (("cyclists/moving/20.csv", GOOD, tarfile.REGTYPE), *members):
            member = tarfile.TarInfo(name)
            member.type = kind
            if isinstance(content, str):
                member.linkname = content
                tar.addfile(member)
            else:
                member.size = len(content)
                tar.addfile(member, io.BytesIO(content))
    return stream.getvalue()


MEMBERS: dict[str, tuple[str, bytes | str, bytes]] = {
    "link to nowhere": ("cyclists/moving/1.csv", "none", tarfile.SYMTYPE),
    "link to itself": ("cyclists/moving/1.csv", "1.csv", tarfile.SYMTYPE),
    "link outside": ("cyclists/moving/1.csv", "/etc/passwd", tarfile.SYMTYPE),
    "hard link to nowhere": ("cyclists/moving/1.csv", "none", tarfile.LNKTYPE),
    "device": ("cyclists/moving/1.csv", "", tarfile.CHRTYPE),
    "pipe": ("cyclists/moving/1.csv", "", tarfile.FIFOTYPE),
    "folder": ("cyclists/moving/1.csv", "", tarfile.DIRTYPE),
    "absolute path": ("/cyclists/moving/1.csv", OTHER, tarfile.REGTYPE),
    "path above": ("../../cyclists/moving/1.csv", OTHER, tarfile.REGTYPE),
    "file twice": ("cyclists/moving/20.csv", OTHER, tarfile.REGTYPE),
    "same name in another folder": ("x/moving/20.csv", OTHER, tarfile.REGTYPE),
}


def broken() -> Iterator[tuple[str, bytes]]:
    """Archives that are not whole."""
    tar = tar_of(("cyclists/moving/21.csv", OTHER, tarfile.REGTYPE))
    whole, second = gzip.compress(tar), tar.index(b"cyclists/moving/21.csv")
    yield "empty", b""
    yield "text", b"no archive"
    yield "wrong checksum", whole[:-8] + bytes(4) + whole[-4:]
    yield "wrong length", whole[:-4] + bytes(4)
    for share in (0.1, 0.5, 0.9, 0.999):
        yield f"cut at {share:.1%}", whole[: int(share * len(whole))]
    yield "tar cut between files", gzip.compress(tar[:second])
    yield "tar cut within a file", gzip.compress(tar[: second + 900])
    yield "tar without its end", gzip.compress(tar.rstrip(b"\0"))
    for place in (20, 300, len(whole) // 2):
        yield (
            f"a byte changed at {place}",
            whole[:place] + bytes([whole[place] ^ 255]) + whole[place + 1 :],
        )


def convert_members(member: tuple[str, bytes | str, bytes], folder: Path) -> Result:
    """Convert an archive with one good file and a member that is none."""
    (folder / "cyclists.tar.gz").write_bytes(gzip.compress(tar_of(member)))
    return converted(ThabVruDataset(folder), folder, 1)


def convert_broken(content: bytes, folder: Path) -> Result:
    """Convert an archive that is not whole."""
    (folder / "cyclists.tar.gz").write_bytes(content)
    convert(ConversionSettings(ThabVruDataset(folder), folder / "cache", progress=False))
    return Result.SILENT


def unpack_any(content: bytes, folder: Path) -> Result:
    """Unpack a download that cannot be unpacked; nothing may appear outside or half."""
    archive = folder / "in" / "a.tar.gz"
    archive.parent.mkdir()
    archive.write_bytes(content)
    try:
        unpack(archive, folder / "in" / "a")
    except DownloadError:
        left = sorted(path.name for path in (*folder.iterdir(), *archive.parent.iterdir()))
        if left != ["a.tar.gz", "in"]:
            return Result.LOST
        raise
    return Result.SILENT


def trials() -> Iterator[Trial]:
    """All faults of archives."""
    members = ((n, partial(convert_members, m)) for n, m in MEMBERS.items() if n != "folder")
    yield from each("archive members", members)
    yield from each("broken archives", ((n, partial(convert_broken, c)) for n, c in broken()))
    downloads = {n: gzip.compress(tar_of(m)) for n, m in MEMBERS.items()}
    hostile = ("link outside", "path above", "device", "hard link to nowhere")
    contents = [*broken(), *((name, downloads[name]) for name in hostile)]
    yield from each("downloads", ((n, partial(unpack_any, c)) for n, c in contents))
