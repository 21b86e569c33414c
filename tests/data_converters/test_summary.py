"""What a conversion prints."""

import pytest

from data_converters.report import ConversionReport, SceneReport
from data_converters.summary import summary


@pytest.fixture
def report():
    scenes = [
        SceneReport(
            "one", "train", "k", tracks_read=1200, agents={"car": 2, "bicycle": 1},
            windows={"bicycle": 30}, rows=1000, interpolated_rows=40,
            rejected=[
                {"track": "7", "reason": "too_short", "detail": "`track` must be longer."},
                {"track": "8", "reason": "too_short", "detail": "Not the first one."},
            ],
            notes={"samples_dropped": 3, "no": 0},
        ),
        SceneReport("two", "test", "k", agents={"bicycle": 4}, windows={"bicycle": 2500}),
        SceneReport("three", "test", "k"),
    ]  # fmt: skip
    return ConversionReport("imptc", {}, "hash", {}, scenes)


def test_a_conversion_is_told_in_a_few_lines(report):
    assert summary(report).splitlines() == [
        "Scenes with agents: 2, from 1,200 tracks; 1,000 rows, 4 % of them between recorded "
        "samples.",
        "Scenes without agents, left out: 1.",
        "Rejected: too_short 2.",
        "Notes: samples_dropped 3.",
        "too_short, the first: `track` must be longer.",
        "",
        "| agents (windows of 4 + 3 s)   | train   | test      |",
        "|:------------------------------|:--------|:----------|",
        "| bicycle                       | 1 (30)  | 4 (2,500) |",
        "| car                           | 2 (0)   | –         |",
    ]


def test_a_conversion_of_nothing_is_told_as_well():
    assert summary(ConversionReport("imptc", {}, "hash", {}, [])).startswith(
        "Scenes with agents: 0"
    )
