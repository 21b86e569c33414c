"""The command that makes a page: folders by themselves or by key, and what it refuses."""

import runpy
import sys

import pytest
from hydra.core.global_hydra import GlobalHydra

from diffstack_mmv.cli import folders_as
from tests.reporting.html import runs


@pytest.fixture
def report(root, monkeypatch):
    """Run the script in this process; the exit status."""

    def run(*arguments):
        GlobalHydra.instance().clear()
        monkeypatch.setattr(sys, "argv", ["report.py", *map(str, arguments)])
        try:
            runpy.run_path(str(root / "scripts" / "report.py"), run_name="__main__")
        except SystemExit as end:
            return end.code
        finally:
            GlobalHydra.instance().clear()
        return 0

    return run


def test_folders_alone_are_the_runs(tmp_path):
    odd = tmp_path / "seed=0"
    odd.mkdir()
    given = ["a", "out=b", str(odd), "-m"]
    assert folders_as("runs", given) == ["out=b", "-m", f"runs=['a','{odd}']"]
    assert folders_as("runs", ["--help"]) == ["--help"]


def test_one_page_tells_of_all_runs(report, tmp_path):
    first, second = runs.training(tmp_path / "first"), runs.simulation(tmp_path / "seed=0, b")
    assert report(first, second, f"out={tmp_path / 'page'}") == 0
    text = (tmp_path / "page" / "report.html").read_text(encoding="utf-8")
    assert "first" in text
    assert "seed=0, b" in text


@pytest.mark.parametrize(
    ("folders", "told"),
    [
        ([], "`runs` must name at least one folder"),
        (["none"], "`runs` must be an existing folder, but got"),
        (["empty"], "`runs` must hold results, but got none in"),
        (["page"], "`out` must be a folder of its own, but got"),
    ],
)
def test_bad_folders_are_refused_in_one_line(report, capfd, tmp_path, folders, told):
    (tmp_path / "empty").mkdir()
    runs.simulation(tmp_path / "page")
    assert report(*(tmp_path / name for name in folders), f"out={tmp_path / 'page'}") == 1
    error = capfd.readouterr().err
    assert told in error
    assert "Traceback" not in error
