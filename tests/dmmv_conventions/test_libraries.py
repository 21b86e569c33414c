"""A library is built once, and never taken from another user."""

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from torch._inductor.exc import InvalidCxxCompiler
from torch._inductor.runtime.cache_dir_utils import default_cache_dir

from dmmv_conventions import libraries
from dmmv_conventions.libraries import CannotBuildError


def test_a_library_of_another_user_is_not_loaded(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(libraries, "build", lambda source, path, *_: planted(path))
    user = tmp_path.stat().st_uid + 1
    monkeypatch.setattr("os.geteuid", lambda: user)
    monkeypatch.setattr(libraries, "ADMINISTRATOR", user)
    with pytest.raises(CannotBuildError, match="belongs to another user"):
        libraries.load("int main() {}")


def test_a_library_that_is_there_is_loaded_without_the_compiler_of_torch(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path))
    libraries.load("int one;")
    told = (
        "import sys; from dmmv_conventions.libraries import load; load('int one;'); "
        "print([name for name in ('torch._inductor', 'torch._dynamo') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_who_asks_while_a_library_is_built_waits_for_it(tmp_path, monkeypatch):
    """`load` remembers per process; the function below it is as another process calls it."""
    built, build = [], libraries.build

    def slowly(source, path, *options):
        built.append(path)
        time.sleep(0.2)
        build(source, path, *options)

    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(libraries, "build", slowly)
    asked = ["int asked_for_twice;"] * 2
    with ThreadPoolExecutor(2) as processes:
        found = list(processes.map(libraries.load.__wrapped__, asked))
    assert len(built) == 1
    assert len({library._name for library in found}) == 1


def test_libraries_lie_where_the_compiler_of_torch_keeps_its_own(tmp_path, monkeypatch):
    monkeypatch.setattr(libraries, "_require_own", lambda path: None)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.delenv("TORCHINDUCTOR_CACHE_DIR", raising=False)
    libraries.load("int two;")
    (found,) = tmp_path.rglob("*.so")
    assert found.parents[1] == Path(default_cache_dir())


def planted(path: Path) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"no library")


def test_what_cannot_be_built_is_told_once(monkeypatch, caplog):
    tried = []

    def refused(source):
        tried.append(source)
        raise CannotBuildError("no compiler")

    caplog.set_level("INFO")
    monkeypatch.setattr(libraries, "load", refused)
    for _ in range(2):
        assert libraries.load_or_tell("nothing at all", "int never_built;") is None
    assert tried == ["int never_built;"]
    told = [each.getMessage() for each in caplog.records if each.name == libraries.__name__]
    assert told == ["No library for nothing at all (no compiler): tensors"]


def test_without_a_compiler_no_processor_is_to_blame(monkeypatch):
    def nothing(search):
        raise InvalidCxxCompiler

    monkeypatch.setattr("torch._inductor.cpp_builder.cpp_compiler_search", nothing)
    with pytest.raises(CannotBuildError, match="No working C"):
        libraries.require_machine("x86-64")


def test_a_folder_that_cannot_be_written_costs_the_library_alone(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path / "file" / "folder"))
    with pytest.raises(CannotBuildError, match="Not a directory|File exists"):
        libraries.load("int not_to_be_written;")
    with pytest.raises(CannotBuildError, match="Not a directory|File exists"):
        libraries.build("int not_to_be_written;", tmp_path / "file" / "folder" / "library.so")


def test_another_processor_gets_a_library_of_its_own(tmp_path, monkeypatch):
    """Machines of a cluster may share the folder, but not all instructions."""
    built = []
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(libraries, "build", lambda source, path, *_: built.append(path))
    for name in ("one", "one", "another"):
        monkeypatch.setattr(libraries, "processor", lambda name=name: name)
        with pytest.raises(CannotBuildError):
            libraries.load("int of_a_processor;")
    assert built[0] == built[1] != built[2]
