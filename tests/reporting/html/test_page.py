"""A page about runs of every kind: complete, valid and self-contained."""

import json
import re
from html.parser import HTMLParser

import pytest

from diffstack_mmv.reporting import write_tables
from diffstack_mmv.reporting.files import read_json
from diffstack_mmv.reporting.html import read_page, read_record, render, write_page
from diffstack_mmv.reporting.html.blocks import Gallery, plain
from diffstack_mmv.reporting.html.tables import read_trajectories
from diffstack_mmv.reporting.table import cell
from tests.reporting.html import runs

VOID = {"meta", "link", "img", "input", "br"}
SVG = "http://www.w3.org/2000/svg"


class Reader(HTMLParser):
    """Checks that elements are closed in order, and keeps ids, references and embedded records."""

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.references, self.records = [], [], [], []

    def handle_starttag(self, tag, attributes):
        told = dict(attributes)
        self.ids += [told["id"]] if "id" in told else []
        self.references += [told[key] for key in ("src", "href") if key in told]
        if tag not in VOID:
            self.open.append((tag, told.get("type")))

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == ("script", "application/json"):
            self.records.append(json.loads(data))


def parsed(text):
    reader = Reader()
    reader.feed(text)
    reader.close()
    assert reader.open == []
    return reader


def page_of(*folders):
    return render([read_page(folder, runs.TITLES) for folder in folders])


@pytest.fixture
def folders(tmp_path):
    return [kind(tmp_path / kind.__name__) for kind in runs.KINDS]


def test_a_page_of_all_kinds_is_valid_and_needs_nothing_else(folders, tmp_path):
    write_page(tmp_path / "page.html", [read_page(each, runs.TITLES) for each in folders])
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>")
    assert set(re.findall(r"https?://[^\"'\s<]*", text)) == {SVG}
    told = parsed(text)
    assert len(set(told.ids)) == len(told.ids)
    for reference in told.references:
        assert reference.startswith("data:") or reference.removeprefix("#") in told.ids


@pytest.mark.parametrize(
    ("kind", "titles"),
    [
        (runs.evaluation, ["Scores by mode", "ADE by situation: bicycle", "Scenes", "Figures"]),
        (runs.training, ["Loss", "Validation by mode: plan ade", "Physical parameters"]),
        (runs.drive, ["Scores", "Cases without success", "Episodes"]),
        (runs.identification, ["Parameters", "Profile: w", "a &lt; b &amp; c"]),
        (runs.comparison, ["Comparison", "0.5 ± 0.1"]),
        (runs.simulation, ["Trajectories", "steer"]),
    ],
)
def test_each_kind_shows_its_parts(kind, titles, tmp_path):
    text = page_of(kind(tmp_path / "run"))
    for title in titles:
        assert title in text
    assert "NaN" not in text.split("<script>")[0]


def test_measured_controls_are_shown_as_their_tables_and_nothing_as_it_is_stored(tmp_path):
    folder = runs.identification(tmp_path / "run")
    content = read_json(folder / "identification.json") | {"controls": "measured"}
    content["models"]["kbm"] |= {"installed": {"antenna_ahead_m": {"estimate": 0.2}}}
    write_tables(folder, content | {"dynamics": "kbm"}, {
        "Models": [{"model": "kbm", "log evidence": -3.5}],
        "Installed": [{"model": "kbm", "unknown": "antenna_ahead_m", "estimate": 0.2}],
        "Recordings": [{"recording": "ride_0", "speed_scale": 0.98}],
        "Roll-outs": [{"group": "all", "line": "kbm", "ADE": 0.1}],
    })  # fmt: skip
    text = page_of(folder).split("<script>")[0]
    for told in ("Models", "-3.5", "antenna_ahead_m", "ride_0", "0.98", "Roll-outs", "Parameters"):
        assert told in text
    assert "{&#x27;" not in text
    assert "{'" not in text
    assert "Tracking errors" not in text


def test_scenes_hold_an_entry_for_every_time(tmp_path):
    [scenes] = [each for each in parsed(page_of(runs.evaluation(tmp_path / "run"))).records
                if isinstance(each, list)]  # fmt: skip
    for scene in scenes:
        assert scene["times"][scene["start"]] == 0.0
        assert {len(body["path"]) for body in scene["bodies"]} == {len(scene["times"])}
        assert len(scene["frames"]) == len(scene["times"])
    ahead = scenes[0]["frames"][scenes[0]["start"] + 1]["ellipses"]
    assert len(ahead) == 3
    assert ahead[0][2:] == [0.1, 0.02, 0.1, 0.5]


def test_another_drive_plays_beside_in_the_same_cases_alone(tmp_path):
    left, right = (runs.drive(tmp_path / name) for name in ("left", "right"))
    page = render([read_page(left, runs.TITLES, beside=right)])
    [scenes] = [each for each in parsed(page).records if isinstance(each, list)]
    ends = "case 0: success after 1.00 s / success after 1.00 s"
    assert scenes[0]["title"] == f"{ends}: diffmpc (left), diffmpc (right)"
    told = json.loads((right / "closed_loop.json").read_text()) | {"phase": "val"}
    (right / "closed_loop.json").write_text(json.dumps(told))
    with pytest.raises(ValueError, match="`beside` must name runs with phase None, but got val in"):
        read_page(left, runs.TITLES, beside=right)


@pytest.mark.parametrize("thoughts", [True, False])
def test_failures_come_first_and_forecasts_where_the_file_has_them(thoughts, tmp_path):
    told = parsed(page_of(runs.drive(tmp_path / "run", thoughts))).records
    [scenes] = [each for each in told if isinstance(each, list)]
    assert [scene["title"].split(":")[0] for scene in scenes] == ["case 1", "case 0"]
    assert len(scenes[0]["times"]) == 4
    assert [each["name"] for each in scenes[0]["series"]][-2:] == ["a", "b"]
    first = scenes[0]["frames"][0]
    assert (len(first["ellipses"]), len(first["lines"])) == ((6, 1) if thoughts else (0, 0))


def test_calibration_is_shown_where_it_was_measured(tmp_path):
    folder = runs.evaluation(tmp_path / "run")
    metrics = json.loads((folder / "metrics.json").read_text())
    assert "Calibration" not in page_of(folder)
    metrics["modes"]["bicycle"] |= {"coverage_50": 0.4, "coverage_90": 0.8}
    (folder / "metrics.json").write_text(json.dumps(metrics))
    charts = parsed(page_of(folder)).records
    [chart] = [each for each in charts if each and "x" in each and each["x"] == "promised share"]
    assert chart["lines"][0] == {"name": "bicycle", "x": [0.5, 0.9], "y": [0.4, 0.8]}


def test_a_report_of_an_earlier_version_is_shown_as_far_as_it_goes(tmp_path):
    folder = runs.evaluation(tmp_path / "run")
    metrics = json.loads((folder / "metrics.json").read_text())
    del metrics["costs"], metrics["situations"]
    for scores in metrics["modes"].values():
        for name in ("vehicle", "n_missing", "miss_rate"):
            del scores[name]
    (folder / "metrics.json").write_text(json.dumps(metrics))
    text = page_of(folder)
    assert "Scores by mode" in text
    assert "misses" not in text


def test_a_folder_without_results_is_refused(tmp_path):
    with pytest.raises(ValueError, match="`runs` must name folders with results, but got none in"):
        page_of(tmp_path)


@pytest.mark.parametrize("text", ["scenario: [", ""])
def test_a_configuration_that_is_broken_is_told(tmp_path, text):
    driven, evaluated = runs.drive(tmp_path / "drive"), runs.evaluation(tmp_path / "evaluation")
    for folder in (driven, evaluated):
        (folder / "config.yaml").write_text(text)
    with pytest.raises(ValueError, match=r"`config.yaml` must be a .*config.yaml"):
        page_of(driven)
    with pytest.raises(ValueError, match=r"`config.yaml` must be a .*config.yaml"):
        read_record(evaluated, runs.TITLES)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_episodes_that_are_cut_off_are_told_with_their_file(tmp_path, share):
    folder = runs.drive(tmp_path / "drive")
    (file,) = folder.glob("episodes/*/*.npz")
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    with pytest.raises(ValueError, match=r"`file` must hold arrays .*test_00000-00001.npz"):
        page_of(folder)


def test_a_table_tells_no_more_digits_than_anybody_reads(tmp_path):
    (tmp_path / "tests.csv").write_text("pair,Δ,n\na - b,-0.10888412594795227,2\nc,0.1,-\n")
    (section,) = read_page(tmp_path, runs.TITLES).sections
    assert section.blocks[0].rows == [["a - b", "-0.1089", "2"], ["c", "0.1", "-"]]


@pytest.mark.parametrize(("width", "height", "wide"), [(300, 100, True), (300, 200, False)])
def test_a_picture_of_panels_side_by_side_gets_the_whole_width(tmp_path, width, height, wide):
    head = b"\x89PNG\r\n\x1a\n" + bytes([0, 0, 0, 13]) + b"IHDR"
    file = tmp_path / "plans_bicycle.png"
    file.write_bytes(head + width.to_bytes(4, "big") + height.to_bytes(4, "big"))
    ((name, _, found),) = Gallery("", [file]).pictures()
    assert (name, found) == ("plans bicycle", wide)


def test_unknown_numbers_are_none_in_records_and_dashes_in_tables():
    assert plain([[1.23456, float("nan")], [None, 2.0]], 2) == [[1.23, None], [None, 2.0]]
    assert [cell(value) for value in (float("nan"), None, 0.12345, "x", 3)] == [
        "–", "–", "0.123", "x", "3",
    ]  # fmt: skip


def test_an_animation_that_was_cut_off_is_no_figure(tmp_path):
    folder = runs.drive(tmp_path / "drive")
    (folder / "plots").mkdir()
    for name in ("case_0.gif", "case_1.gif.part.gif"):
        (folder / "plots" / name).write_bytes(b"GIF89a")
    sections = read_page(folder, runs.TITLES).sections
    (figures,) = (each for each in sections if each.title == "Figures")
    assert [file.name for file in figures.blocks[0].files] == ["case_0.gif"]


def test_a_drive_without_a_step_is_told(tmp_path):
    (tmp_path / "trajectory_kbm.csv").write_text("time_s,position_x_m\n")
    with pytest.raises(ValueError, match="`trajectory` must hold a row per step, but got none"):
        read_trajectories(tmp_path)
