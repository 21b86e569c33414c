"""The command that makes a page: folders by themselves or by key, and what it refuses."""

import pytest

from diffstack_mmv.commands.cli import folders_as
from diffstack_mmv.reporting.html import names_apart
from tests.reporting.html import runs


@pytest.mark.parametrize(
    ("given", "understood"),
    [
        ("a out=b seed=0 -m", "out=b -m runs=['a','seed=0']"),
        ("--help", "--help"),
        ("--cfg job out=b", "--cfg job out=b"),
        ("a -c job", "-c job runs=['a']"),
    ],
)
def test_folders_alone_are_the_runs(tmp_path, monkeypatch, given, understood):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "seed=0").mkdir()
    assert folders_as("runs", given.split()) == understood.split()


def test_one_page_tells_of_all_runs(succeed, tmp_path):
    first, second = runs.training(tmp_path / "first"), runs.simulation(tmp_path / "seed=0, b")
    succeed("report", first, second, f"out={tmp_path / 'page'}")
    text = (tmp_path / "page" / "report.html").read_text(encoding="utf-8")
    assert "first" in text
    assert "seed=0, b" in text


def test_runs_whose_folders_have_one_name_are_told_apart(tmp_path):
    folders = [tmp_path / each for each in ("runs/kbm", "reports/kbm", "kbm", "reports/gm3")]
    alone = f"{tmp_path.name}/kbm"
    assert names_apart(folders) == ["runs/kbm", "reports/kbm", alone, "gm3"]
    assert names_apart([folders[0], folders[0]]) == ["kbm", "kbm"]


def test_the_page_names_runs_apart(succeed, tmp_path):
    for name in ("runs", "drives"):
        (tmp_path / name).mkdir()
    first, second = runs.training(tmp_path / "runs/kbm"), runs.simulation(tmp_path / "drives/kbm")
    succeed("report", first, second, f"out={tmp_path / 'page'}")
    text = (tmp_path / "page" / "report.html").read_text(encoding="utf-8")
    assert "<title>runs/kbm, drives/kbm" in text


def test_a_page_beside_a_run_leaves_its_configuration(succeed, tmp_path):
    first = runs.training(tmp_path / "first")
    (tmp_path / "metrics.json").write_text("{}")
    (tmp_path / "config.yaml").write_text("of: the evaluation\n")
    succeed("report", first, f"out={tmp_path}")
    assert (tmp_path / "config.yaml").read_text() == "of: the evaluation\n"
    assert (tmp_path / "report_config.yaml").is_file()


@pytest.mark.parametrize(
    ("folders", "told"),
    [
        ([], "`runs` must name at least one folder"),
        (["none"], "`runs` must be an existing folder, but got"),
        (["empty"], "`runs` must hold results, but got none in"),
        (["page"], "`out` must be a folder of its own, but got"),
    ],
)
def test_bad_folders_are_refused_in_one_line(refusal, tmp_path, folders, told):
    (tmp_path / "empty").mkdir()
    runs.simulation(tmp_path / "page")
    given = [*(tmp_path / name for name in folders), f"out={tmp_path / 'page'}"]
    assert told in refusal("report", *given)
