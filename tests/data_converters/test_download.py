"""Download from a record, against a server on this machine."""

import errno
import hashlib
import io
import json
import re
import tarfile
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from data_converters import ConversionError
from data_converters.downloading import DownloadError
from data_converters.imptc import download as module
from data_converters.imptc.download import Part, download_imptc, read_record


def archive(files):
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w:gz") as tar:
        for name, content in files.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            tar.addfile(entry, io.BytesIO(content))
    return stream.getvalue()


NOISE = hashlib.shake_256(b"noise").digest(300_000)


class Record(ThreadingHTTPServer):
    """A record with files; it can break off transfers and ignore ranges."""

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.address = f"http://127.0.0.1:{self.server_port}"
        self.files = {
            "imptc_samples.tar.gz": archive({"0000_20230322_081506/noise": NOISE}),
            "imptc_set_01.tar.gz": archive({"0001_20230322_082006/noise": NOISE}),
            "imptc_set_02.tar.gz": archive({"0050_20230322_122506/noise": NOISE}),
            "imptc_trajectory_dataset.tar.gz": archive({"train/0000/track.json": b"{}"}),
        }
        self.break_after = None
        self.breaks = 0
        self.ranges = True
        self.wrong_sum = False
        self.requests = []

    def record(self):
        return {
            "files": [
                {
                    "key": name,
                    "size": len(content),
                    "checksum": "md5:"
                    + ("0" * 32 if self.wrong_sum else hashlib.md5(content).hexdigest()),
                    "links": {"self": f"{self.address}/files/{name}"},
                }
                for name, content in self.files.items()
            ]
        }


class Handler(BaseHTTPRequestHandler):
    def log_message(self, *arguments):
        """Keep quiet."""

    def do_GET(self):
        if self.path == "/record":
            return self._send(200, json.dumps(self.server.record()).encode())
        name = self.path.rsplit("/", 1)[-1]
        if name not in self.server.files:
            return self._send(404, b"nothing here")
        start = 0
        wanted = re.fullmatch(r"bytes=(\d+)-", self.headers.get("Range", ""))
        if wanted and self.server.ranges:
            start = int(wanted[1])
        self.server.requests.append((name, start))
        return self._send(206 if start else 200, self.server.files[name][start:])

    def _send(self, status, content):
        self.send_response(status)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.server.break_after is not None and self.server.breaks > 0 and len(content) > 10_000:
            self.server.breaks -= 1
            content = content[: self.server.break_after]
            self.close_connection = True
        self.wfile.write(content)


@pytest.fixture
def record():
    server = Record()
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()
    thread.join()


def download(record, out, parts=(Part.SAMPLE,), **options):
    return download_imptc(
        out, parts, record_url=f"{record.address}/record", progress=False, **options
    )


@pytest.mark.parametrize(
    ("part", "folders"),
    [
        (Part.SAMPLE, ["imptc_samples"]),
        (Part.SEQUENCES, ["imptc_set_01", "imptc_set_02"]),
        (Part.VRU, ["imptc_trajectory_dataset"]),
    ],
)
def test_a_part_is_fetched_and_unpacked(record, tmp_path, part, folders):
    assert [folder.name for folder in download(record, tmp_path, [part])] == folders
    assert sorted(path.name for path in tmp_path.iterdir()) == folders
    assert all(any(path.is_file() for path in (tmp_path / f).rglob("*")) for f in folders)


@pytest.mark.parametrize(
    ("ranges", "starts"),
    [(True, [0, 100_000, 200_000]), (False, [0, 0, 0])],
    ids=["at the byte where it stopped", "from the start without ranges"],
)
def test_a_transfer_that_breaks_off_goes_on(record, tmp_path, ranges, starts):
    record.break_after, record.breaks, record.ranges = 100_000, 2, ranges
    folder = download(record, tmp_path)[0]
    assert (folder / "0000_20230322_081506" / "noise").read_bytes() == NOISE
    assert [start for _, start in record.requests] == starts


def test_a_later_run_goes_on_where_an_earlier_one_gave_up(record, tmp_path):
    record.break_after, record.breaks = 100_000, 1
    with pytest.raises(DownloadError, match="100000 after 1 attempts.*goes on"):
        download(record, tmp_path, attempts=1)
    assert (tmp_path / "imptc_samples.tar.gz.part").stat().st_size == 100_000
    download(record, tmp_path)
    assert record.requests[-1] == ("imptc_samples.tar.gz", 100_000)


def test_a_wrong_checksum_is_refused_and_leaves_nothing(record, tmp_path):
    record.wrong_sum = True
    with pytest.raises(DownloadError, match="MD5 sum 0000.*imptc_samples"):
        download(record, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_what_is_unpacked_is_not_fetched_again(record, tmp_path):
    download(record, tmp_path)
    download(record, tmp_path)
    assert len(record.requests) == 1


def test_a_kept_archive_is_verified_instead_of_fetched(record, tmp_path):
    folder = download(record, tmp_path, keep_archives=True)[0]
    (folder / "0000_20230322_081506" / "noise").unlink()
    (folder / "0000_20230322_081506").rmdir()
    folder.rmdir()
    download(record, tmp_path)
    assert len(record.requests) == 1
    assert (folder / "0000_20230322_081506" / "noise").is_file()


@pytest.mark.parametrize(
    "content", [b"no archive", archive({"../outside": b"x"})], ids=["broken", "outside"]
)
def test_a_bad_archive_leaves_no_folder(record, tmp_path, content):
    record.files["imptc_samples.tar.gz"] = content
    with pytest.raises(DownloadError, match="`archive` must be whole"):
        download(record, tmp_path / "out")
    assert not (tmp_path / "out" / "imptc_samples").exists()
    assert not (tmp_path / "outside").exists()


def test_a_part_that_the_record_lacks_is_named(record, tmp_path):
    del record.files["imptc_trajectory_dataset.tar.gz"]
    with pytest.raises(DownloadError, match="'vru'"):
        download(record, tmp_path, [Part.VRU])


@pytest.mark.parametrize("path", ["/files/nothing", "/record-that-is-not-there"])
def test_a_record_that_cannot_be_read_is_named(record, path):
    with pytest.raises(DownloadError, match="record_url"):
        read_record(record.address + path)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_gives_one_message(record, tmp_path, monkeypatch, number):
    def full(*arguments, **options):
        raise OSError(number, "No space left on device")

    monkeypatch.setattr(module, "unpack", full)
    with pytest.raises(ConversionError, match="free disk space"):
        download(record, tmp_path)
