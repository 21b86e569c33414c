"""The environment of the peers: what can be had, what cannot and why."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
spec = importlib.util.spec_from_file_location("build_peers", ROOT / "benchmarks" / "build_peers.py")
build_peers = importlib.util.module_from_spec(spec)
spec.loader.exec_module(build_peers)


@pytest.fixture
def repository(tmp_path):
    """A repository with one module, and its commit."""
    place = tmp_path / "origin"
    git = ("git", "-C", str(place), "-c", "user.name=a", "-c", "user.email=a@b")
    subprocess.run(["git", "init", "--quiet", str(place)], check=True)
    (place / "peer.py").write_text("ANSWER = 42\n")
    subprocess.run([*git, "add", "."], check=True)
    subprocess.run([*git, "commit", "--quiet", "-m", "first"], check=True)
    head = subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True)
    return place, head.stdout.strip()


def test_a_checkout_that_is_here_is_brought_to_its_commit_and_kept(repository, tmp_path):
    place, commit = repository
    source = build_peers.Repository("/nowhere", commit)
    for _ in range(2):  # the second time nothing is fetched
        assert build_peers.check_out(source, place, tmp_path / "peer") is None
        place = Path("/nowhere")
    assert (tmp_path / "peer" / "peer.py").exists()


def test_a_commit_that_is_not_there_is_told_and_leaves_nothing(repository, tmp_path):
    source = build_peers.Repository("/nowhere", "0" * 40)
    reason = build_peers.check_out(source, repository[0], tmp_path / "peer")
    assert "commit 0000000000" in reason
    assert not (tmp_path / "peer").exists()


def test_what_cannot_be_had_is_named_with_the_remedy(monkeypatch, tmp_path, repository):
    place, commit = repository
    both = {"one": build_peers.Repository("/nowhere", commit), "two": (str(place), commit)}
    both["two"] = build_peers.Repository(*both["two"])
    monkeypatch.setattr(build_peers, "REPOSITORIES", both)
    absent = build_peers.sources(tmp_path, tmp_path, {"one": None, "two": None})
    assert list(absent) == ["one"]
    assert "make peers ONE=PATH" in absent["one"]
    assert (tmp_path / "zz_sources.pth").read_text() == f"{tmp_path}/src/two\n"


def test_packages_that_cannot_be_had_one_by_one_are_named(monkeypatch, tmp_path):
    lock = tmp_path / "lock"
    good = "good==1 \\\n    --hash=sha256:aa \\\n    --hash=sha256:ab\n"
    lock.write_text(good + "bad==2 \\\n    --hash=sha256:bb\n")
    assert len(build_peers.requirements(lock)) == 2

    def call(*command):
        return "no such version" if "bad" in Path(command[-1]).read_text() else None

    monkeypatch.setattr(build_peers, "call", call)
    assert build_peers.install(Path("python"), lock) == {"bad": "no such version"}


def test_every_package_of_the_lock_has_one_version_and_hashes_and_none_is_torch():
    wanted = build_peers.requirements(build_peers.LOCK)
    names = {each.split("==")[0].lower() for each in wanted}
    assert len(names) == len(wanted) > 40
    assert all("==" in each and "--hash=sha256:" in each for each in wanted)
    assert {"crocoddyl", "casadi", "jax", "mpc"} < names
    assert not {name for name in names if name in ("torch", "triton") or name.startswith("nvidia")}


def test_a_module_that_is_missing_is_told(tmp_path):
    told = build_peers.importable(Path(sys.executable), ("json", "no_such_module"))
    assert told["json"] is None
    assert "no_such_module" in told["no_such_module"]
