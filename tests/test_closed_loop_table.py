"""The command that drives the rows of a table."""

import runpy
import sys

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from dmmv_conventions.configs import config_folder
from scripts.closed_loop_table import check

TABLES = sorted(path.stem for path in (config_folder() / "table").glob("*.yaml"))


@pytest.fixture
def table(root, monkeypatch, tmp_path, capfd):
    """Run the script in this process; exit status and what it says."""

    def run(*arguments):
        GlobalHydra.instance().clear()
        monkeypatch.setattr(sys, "argv", ["table.py", *arguments, f"out={tmp_path}"])
        try:
            runpy.run_path(str(root / "scripts" / "closed_loop_table.py"), run_name="__main__")
            status = 0
        except SystemExit as end:
            status = end.code
        finally:
            GlobalHydra.instance().clear()
        told = capfd.readouterr()
        return status, told.out + told.err

    return run


@pytest.mark.parametrize("name", TABLES)
def test_every_row_of_every_table_can_be_named_and_compared(name):
    told = OmegaConf.load(config_folder() / "table" / f"{name}.yaml")
    rows, places = set(told.rows), set(told.places)
    assert rows
    assert places
    for row, others in (told.get("against") or {}).items():
        assert {row, *others} <= rows
    for place, driven in (told.get("drives") or {}).items():
        assert place in places
        assert set(driven) <= rows


@pytest.mark.parametrize("name", TABLES)
def test_every_place_and_every_row_is_a_setting_of_navigate(name):
    loaded = OmegaConf.load(config_folder() / "table" / f"{name}.yaml")
    told = OmegaConf.create({"table": loaded}).table
    composed = set()  # a row of settings that others have had adds nothing
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        places, rows = list(told.places.values()), list(told.rows.values())
        for number in range(max(len(places), len(rows))):
            given = {*places[number % len(places)], *rows[number % len(rows)]}
            if not given <= composed:
                compose("navigate", [*told.settings, *given])
            composed |= given


@pytest.mark.parametrize(
    ("arguments", "ended", "line"),
    [
        (["table=paper", "rows=[ours]"], 0, "5 of 5 drives to do"),
        (["rows=[unicorn]"], 1, "`rows` must be some of"),
        (["table=paper", "table.against.ours=[theirs]"], 1, "`table.against.ours` must be some of"),
        (["table=paper", "+table.against.mine=[ours]"], 1, "`table.against` must be some of"),
        (["table=paper", "+table.drives.hill=[ours]"], 1, "`table.drives` must be some of"),
    ],
    ids=["rows of the table", "rows it does not have", "against none", "of none", "nowhere"],
)
def test_a_dry_run_tells_what_is_left_or_wrong(table, arguments, ended, line):
    status, told = table(*arguments, "dry_run=true")
    assert status == ended
    assert line in told


CITR = ["table=recorded", "places=[CITR]", "rows=[straight]"]


def test_no_drive_is_begun_before_the_recordings_are_converted(table, tmp_path):
    rows = "rows=[straight,stop and go]"
    status, told = table("table=recorded", rows, f"table.caches={tmp_path}/none")
    assert status == 1
    last = told.strip().splitlines()[-1]
    assert last.startswith("`data.cache` must hold the finished conversion of every data set, but")
    assert f"none of 'eth_ucy_eth' in {tmp_path}/none/eth_ucy, none of 'citr' in" in last
    held_out = "data=eth_ucy data.held_out=eth"
    for each in (held_out, "data=citr", "data=dut", "data=sdd"):
        name = each.split()[0].removeprefix("data=")
        assert f"{each} data.root=RECORDINGS data.cache={tmp_path}/none/{name}" in last
    assert last.count("scripts/convert.py") == 4
    assert not (tmp_path / "logs").exists()


@pytest.mark.parametrize("lacking", ["caches", "people_checkpoint"])
def test_a_dry_run_needs_no_recordings_and_no_checkpoint(table, tmp_path, lacking):
    status, told = table("table=recorded", f"table.{lacking}={tmp_path}/none", "dry_run=true")
    assert (status, "56 of 56 drives to do" in told) == (0, True)


@pytest.mark.parametrize(
    "where", ["table.caches={}", "overrides=['++data.cache=\"{}/citr\"']"], ids=["table", "added"]
)
def test_converted_recordings_are_driven_through(table, tmp_path, where):
    (tmp_path / "caches" / "citr" / "citr").mkdir(parents=True)
    state = tmp_path / "caches" / "citr" / "citr" / "cache.json"
    state.write_text('{"format_version": 1, "complete": true, "scenes": []}')
    given = [*CITR, where.format(tmp_path / "caches")]
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        check(compose("closed_loop_table", [*given, f"out={tmp_path}"]))
    GlobalHydra.instance().clear()
    lacking = f"table.people_checkpoint={tmp_path}/no.ckpt"
    rows = "rows=['DiffMPC, trained predictor']"
    status, told = table(*CITR, rows, f"table.caches={tmp_path}/caches", lacking)
    assert status == 1
    assert "`people_checkpoint` must be" in told
    assert "no.ckpt" in told


@pytest.mark.slow
def test_drives_are_done_once_and_told_in_one_table(table, tmp_path):
    part = ["table=crowdnav", "places=[circle]", "rows=[straight,blind driver]"]
    less = 'overrides=["cases=2","chunk=2"]'
    assert table(*part, less)[0] == 0
    assert "blind driver" in (tmp_path / "table.md").read_text()
    status, told = table(*part, less)
    assert status == 0
    assert "0 of 2 drives to do" in told
