"""Write what the locked environment consists of: a CycloneDX list and a table of licences."""

import argparse
import json
import logging
import re
from importlib.metadata import Distribution, distribution
from pathlib import Path
from typing import Any, NamedTuple

logger = logging.getLogger(__name__)
LOCKS = ("requirements.lock", "requirements-cuda.lock")


class Locked(NamedTuple):
    """A locked package with the SHA-256 sums of its files."""

    name: str
    version: str
    hashes: list[str]


def read_lock(text: str) -> list[Locked]:
    """Packages of a lock file."""
    found: list[Locked] = []
    for line in text.splitlines():
        named = re.match(r"([A-Za-z0-9_.-]+)==([^ ;\\]+)", line)
        if named:
            found.append(Locked(named[1], named[2], []))
        if found:
            found[-1].hashes.extend(re.findall(r"sha256:([0-9a-f]{64})", line))
    return found


def licence(package: Distribution | None) -> str:
    """The licence that an installed package states, "unknown" where it states none."""
    if package is None:
        return "not installed here"
    stated: Any = package.metadata
    classes = [
        each.split(" :: ")[-1]
        for each in stated.get_all("Classifier") or []
        if each.startswith("License :: ") and each != "License :: OSI Approved"
    ]
    text = stated.get("License-Expression") or ", ".join(classes) or stated.get("License") or ""
    return text.splitlines()[0][:80] if text.strip() else "unknown"


def installed(name: str) -> Distribution | None:
    """The installed package of that name."""
    try:
        return distribution(name)
    except ModuleNotFoundError:
        return None


def component(package: Locked) -> dict[str, Any]:
    """A package as CycloneDX 1.5 describes it."""
    return {
        "type": "library",
        "name": package.name,
        "version": package.version,
        "purl": f"pkg:pypi/{package.name.lower().replace('_', '-')}@{package.version}",
        "licenses": [{"license": {"name": licence(installed(package.name))}}],
        "hashes": [{"alg": "SHA-256", "content": each} for each in package.hashes],
    }


def main(out: Path, root: Path) -> None:
    """Write sbom.json and licences.md to `out`."""
    packages = [each for lock in LOCKS for each in read_lock((root / lock).read_text("utf-8"))]
    content = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {"component": {"type": "application", "name": "diffstack_mmv"}},
        "components": [component(package) for package in packages],
    }
    out.mkdir(parents=True, exist_ok=True)
    (out / "sbom.json").write_text(json.dumps(content, indent=1) + "\n", "utf-8")
    rows = [
        f"| {each.name} | {each.version} | {licence(installed(each.name))} |" for each in packages
    ]
    table = ["| package | version | licence |", "|---|---|---|", *rows]
    (out / "licences.md").write_text("\n".join(table) + "\n", "utf-8")
    logger.info("%d packages: %s", len(packages), out / "sbom.json")


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "out", nargs="?", type=Path, default="outputs", help="folder (default: outputs)"
    )
    main(parser.parse_args().out, Path(__file__).resolve().parents[1])
