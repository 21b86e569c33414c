"""Builds libraries in C++, once per source and machine, and calls them."""

import ctypes
import functools
import getpass
import hashlib
import logging
import os
import platform
import re
import subprocess
import tempfile
from importlib.resources import files
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dmmv_conventions.checks import message
from dmmv_conventions.locks import in_turn

LOGGER = logging.getLogger(__name__)
FLAGS = (
    *("-std=c++20", "-O2", "-fPIC", "-shared", "-Wno-psabi", "-pthread"),
    *("-fno-math-errno", "-fno-trapping-math"),  # but not: that all numbers are finite
    "-fvisibility=hidden",  # all libraries have the same names inside, which must not meet
)

REALS = {torch.float32: "float", torch.float64: "double"}
"""Types of numbers that libraries are built for, as C++ calls them."""
ADMINISTRATOR = 0  # whose files everyone trusts anyway
LIMIT_S = 1200
"""Seconds that a compiler may take: on a crowded machine many times what it takes alone."""


class CannotBuildError(Exception):
    """There is no compiler, or it refuses the source."""


def build(source: str, target: Path, machine: str = "native", *flags: str) -> None:
    """Compile a source to a shared library.

    Args:
        source: C++.
        target: The library, written as a whole or not at all.
        machine: Processor as the compiler calls it; "native" is this one.
        flags: Options of the compiler besides `FLAGS`.

    Raises:
        CannotBuildError: There is no compiler, it refuses the source, it takes too long, or the
            library cannot be written.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target.parent) as folder:
            written, library = Path(folder, "source.cpp"), Path(folder, target.name)
            written.write_text(source)
            options = (*FLAGS, *flags, f"-march={machine}")
            command = [_compiler(), *options, str(written), "-o", str(library)]
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=LIMIT_S, check=False
            )
            if done.returncode:
                raise CannotBuildError(next(iter(done.stderr.splitlines()), "no message"))
            os.replace(library, target)
    except (OSError, subprocess.TimeoutExpired) as failure:
        raise CannotBuildError(str(failure)) from failure


def _compiler() -> str:
    """The C++ compiler.

    Raises:
        CannotBuildError: There is none.
    """
    from torch._inductor.cpp_builder import get_cpp_compiler
    from torch._inductor.exc import InvalidCxxCompiler

    try:
        return get_cpp_compiler()
    except (InvalidCxxCompiler, OSError) as failure:
        raise CannotBuildError(str(failure)) from failure


def require_machine(machine: str) -> None:
    """Refuse a processor that the C++ compiler does not build for, by a library of nothing.

    Raises:
        ValueError: It cannot be built; this says why.
        CannotBuildError: There is no compiler.
    """
    _compiler()  # without one, no processor is to blame
    with tempfile.TemporaryDirectory() as folder:
        try:
            build("", Path(folder, "nothing.so"), machine)
        except CannotBuildError as failure:
            found = f"{machine!r} ({failure})"
            remedy = "Give native, or what the option -march= of the compiler takes."
            wanted = "be a processor that the C++ compiler builds for"
            raise ValueError(message("machine", wanted, found, "", remedy)) from failure


@functools.cache
def load(source: str, *flags: str) -> ctypes.CDLL:
    """The library of a source, built at its first use on a machine: once, whoever asks meanwhile.

    Args:
        source: C++.
        flags: Options of the compiler besides `FLAGS`.

    Raises:
        CannotBuildError: It cannot be built or read, or another user wrote it.
    """
    told = (source, " ".join(FLAGS + flags), platform.machine(), processor())
    name = hashlib.sha256("\n".join(told).encode()).hexdigest()
    try:
        path = _compilers_folder() / "dmmv" / f"{name}.so"
        if not path.exists():
            with in_turn(path.parent, name):
                if not path.exists():  # another process, or thread, may have built it meanwhile
                    build(source, path, "native", *flags)
        _require_own(path)
        return ctypes.CDLL(str(path))
    except OSError as failure:
        raise CannotBuildError(str(failure)) from failure


def _compilers_folder() -> Path:
    """Where the compiler of torch keeps what it has built.

    Asked of torch itself it would take a second, for packages that a library needs in no other way.
    """
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # one without a name, as in a container
        user = f"uid_{os.getuid()}"
    name = re.sub(r'[\\/:*?"<>|]', "_", user)
    usual = Path(tempfile.gettempdir(), f"torchinductor_{name}")
    folder = Path(os.environ.get("TORCHINDUCTOR_CACHE_DIR", usual))
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@functools.cache
def processor() -> str:
    """Model and abilities of this machine's processor.

    Machines of a cluster may share the compiler's folder: what was built for one of them has
    instructions that another may lack, and would end the process.
    """
    file = Path("/proc/cpuinfo")
    lines = file.read_text().splitlines() if file.is_file() else [platform.processor()]
    told = {line for line in lines if line.startswith(_TELLING)}
    return "\n".join([torch.backends.cpu.get_cpu_capability(), *sorted(told or lines[:1])])


_TELLING = ("model name", "flags", "Features", "CPU part")


def libraries_loaded() -> int:
    """How many libraries this process has: what adds one takes longer than doing it again."""
    return load.cache_info().currsize


@functools.cache
def load_or_tell(purpose: str, source: str, *flags: str) -> ctypes.CDLL | None:
    """The library of a source; None where it cannot be built, with a line in the log, once.

    Args:
        purpose: What it is for, told to people.
        source: C++.
        flags: Options of the compiler besides `FLAGS`.
    """
    try:
        return load(source, *flags)
    except CannotBuildError as failure:
        LOGGER.info("No library for %s (%s): tensors", purpose, failure)
        return None


def _require_own(path: Path) -> None:
    """Refuse a library of another user: the compiler's folder may lie where everyone writes.

    Raises:
        CannotBuildError: The file or one of its folders is of another user.
    """
    for place in (path, path.parent, path.parents[1]):
        if place.stat().st_uid not in (ADMINISTRATOR, os.geteuid()):
            raise CannotBuildError(f"{place} belongs to another user")


def header(package: str, name: str) -> str:
    """A header of a package as a part of a source, without its own inclusions.

    `load` finds libraries by their whole source, so that one is built again when a header changes.

    Args:
        package: Where it stands.
        name: Its name without its ending.
    """
    lines = files(package).joinpath(f"{name}.hpp").read_text().splitlines()
    return "\n".join(line for line in lines if not line.startswith(('#include "', "#pragma once")))


def within_reach(*tensors: Tensor) -> bool:
    """Whether libraries, which run on the host, can take tensors: as they are, or copies of them.

    Other devices than CUDA were not tried.
    """
    return all(tensor.device.type in ("cpu", "cuda") for tensor in tensors)


def brought(*tensors: Tensor) -> list[Tensor]:
    """Contiguous copies on the host, where libraries run; a tensor itself where it is so."""
    return [tensor.detach().to("cpu").contiguous() for tensor in tensors]


def pointers(*tensors: Tensor | None) -> list[Any]:
    """Addresses of contiguous tensors, none for None."""
    return [None if each is None else ctypes.c_void_p(each.data_ptr()) for each in tensors]


def counts(*numbers: int) -> list[Any]:
    """Whole numbers as a library takes them."""
    return [ctypes.c_long(number) for number in numbers]
