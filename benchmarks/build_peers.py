"""The environment of the solvers to compare with: a virtual environment of its own, beside that of the project.

    python benchmarks/build_peers.py outputs/peers                       # `make peers`
    python benchmarks/build_peers.py outputs/peers --trajax CHECKOUT --diffmpc CHECKOUT

Packages come in the versions of requirements-peers.lock; torch is that of the project, so that none with CUDA is fetched.
trajax and Toyota's diffmpc are in no package index: they come from their public repositories, or from checkouts that are
here, at one commit. What cannot be had is told at the end, and the tables name its rows as absent. Takes 1.3 GB.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "requirements-peers.lock"
MODULES = ("casadi", "crocoddyl", "mpc", "pypose", "jax", "osqp", "qpth", "cvxpylayers", "cvxpygen")


class Repository(NamedTuple):
    """Where a peer without a package comes from."""

    address: str
    commit: str


REPOSITORIES = {
    "trajax": Repository(
        "https://github.com/google/trajax", "c94a637c5a397b3d4100153f25b4b165507b5b20"
    ),
    "diffmpc": Repository(
        "https://github.com/ToyotaResearchInstitute/diffmpc",
        "146be51053fe45675d8f4d773627983f74ec0539",
    ),
}


def call(*command):
    """The last line of what a command complains of, or None where it succeeded."""
    try:
        done = subprocess.run(
            [str(part) for part in command],
            capture_output=True,
            text=True,
            check=False,
            timeout=1800,
            env=os.environ | {"GIT_TERMINAL_PROMPT": "0"},
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    if done.returncode == 0:
        return None
    return next(iter(done.stderr.strip().splitlines()[::-1]), f"status {done.returncode}")


def environment(folder):
    """Interpreter of a virtual environment that sees the project's packages after its own."""
    python = folder / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    name = f"python{sys.version_info.major}.{sys.version_info.minor}"
    own = folder / "lib" / name / "site-packages"
    (own / "zz_project.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    return python, own


def requirements(lock):
    """The packages of a lock, one text with hashes each."""
    return re.findall(r"^[^\s#].*(?:\n[ ]+.*)*", lock.read_text(), re.MULTILINE)


def install(python, lock):
    """Install all packages; those that cannot be had, with the reason."""
    pip = (python, "-m", "pip", "install", "--quiet", "--no-deps", "--require-hashes")
    if call(*pip, "--requirement", lock) is None:
        return {}
    absent = {}
    with tempfile.TemporaryDirectory() as folder:
        for requirement in requirements(lock):
            alone = Path(folder, "one.txt")
            alone.write_text(requirement + "\n")
            if reason := call(*pip, "--requirement", alone):
                absent[requirement.split("==")[0]] = reason
    return absent


def check_out(repository, source, folder):
    """Bring a repository to its commit; why not, or None."""
    if not (folder / ".git").exists():
        origin = source or repository.address
        if reason := call("git", "clone", "--quiet", "--no-checkout", origin, folder):
            return f"{reason} ({origin})"
    reason = call("git", "-C", folder, "checkout", "--quiet", repository.commit)
    if reason:
        shutil.rmtree(folder)
        return f"commit {repository.commit[:10]}: {reason}"
    return None


def sources(folder, own, checkouts):
    """Bring all repositories, and let the environment see them; those that cannot be had, with the reason."""
    absent, places = {}, []
    (folder / "src").mkdir(exist_ok=True)
    for name, repository in REPOSITORIES.items():
        place = folder / "src" / name
        if reason := check_out(repository, checkouts[name], place):
            absent[name] = f"{reason}; with a checkout that is here: make peers {name.upper()}=PATH"
        else:
            places.append(str(place))
    (own / "zz_sources.pth").write_text("".join(f"{place}\n" for place in places))
    return absent


def importable(python, names):
    """Of each module why it cannot be imported, or None."""
    return {name: call(python, "-c", f"import {name}") for name in names}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    for name in REPOSITORIES:
        parser.add_argument(f"--{name}", type=Path, help="git checkout that is here")
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    print(f"{LOCK.name} into {folder}, 1.3 GB, some minutes", flush=True)
    python, own = environment(folder)
    told = install(python, LOCK)
    told |= sources(folder, own, {name: getattr(arguments, name) for name in REPOSITORIES})
    for name, reason in importable(python, (*MODULES, *REPOSITORIES)).items():
        if reason:
            told.setdefault(name, reason)
        else:
            print(f"{name}: there")
    for name, reason in told.items():
        print(f"{name}: ABSENT, its rows will say so. {reason}")


if __name__ == "__main__":
    main()
