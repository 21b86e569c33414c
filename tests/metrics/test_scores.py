"""The registries name every score that the package computes, logs or is asked for."""

import pytest
import yaml

from diffstack_mmv.metrics import CLOSED_LOOP, OPEN_LOOP, Score
from diffstack_mmv.metrics.scores import EVALUATED
from diffstack_mmv.simulation.summary import episode_scores

ALL = [*EVALUATED.values(), *CLOSED_LOOP.values()]
GROWING = ["solved", "coverage", "success", "avg_min_dist", "mean_episode_min_dist"]


@pytest.mark.parametrize("registry", [EVALUATED, CLOSED_LOOP], ids=["open", "closed"])
def test_names_and_headings_are_unique(registry):
    assert all(name == score.name for name, score in registry.items())
    assert len({score.heading for score in registry.values()}) == len(registry)


@pytest.mark.parametrize("score", ALL, ids=lambda score: score.name)
def test_unit_is_a_unit_and_agrees_with_the_name(score):
    assert score.unit in ("m", "s", "ms", "m²", "m/s²", "m/s³", "nats", "1")
    *_, ending = score.name.split("_")
    assert ending not in ("m", "s", "ms") or ending == score.unit


@pytest.mark.parametrize("score", ALL, ids=lambda score: score.name)
def test_less_is_better_but_for_success_coverage_and_clearance(score) -> None:
    assert score.lower_is_better is not score.name.startswith(tuple(GROWING))


@pytest.mark.parametrize(("unit", "heading"), [("m", "ADE [m]"), ("1", "ADE")])
def test_heading_tells_the_unit_if_there_is_one(unit, heading):
    assert Score("ade", "ADE", unit, True).heading == heading


def test_every_score_of_episodes_is_registered_and_computed():
    assert [*episode_scores(), "control_time_ms"] == list(CLOSED_LOOP)


def test_configurations_ask_for_registered_scores(root):
    losses = [yaml.safe_load(path.read_text()) for path in (root / "configs/loss").glob("*.yaml")]
    # an option that begins with another one may leave its score as it is
    assert all("watched" in each or "defaults" in each for each in losses)
    monitored = [each["watched"] for each in losses if "watched" in each]
    compared = yaml.safe_load((root / "configs/compare.yaml").read_text())["score"]
    assert monitored
    assert {name.removeprefix("val/") for name in [*monitored, compared]} <= set(OPEN_LOOP)
