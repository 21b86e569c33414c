"""The dashboard: built from keys that training really logs."""

import json
import re
import sys
import types

import pytest

from diffstack_mmv.callbacks import build_dashboard, dashboard
from diffstack_mmv.callbacks.dashboard import PANELS


def test_without_the_extra_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb_workspaces", None)
    with pytest.raises(ImportError, match=r"diffstack_mmv\[dashboard\]"):
        build_dashboard("team", "project", ["bicycle"])


@pytest.fixture
def stand_in(monkeypatch):
    """A package that keeps the sections that it is given."""
    sections = {}

    def keep(**given):
        sections.update({section.name: section.panels for section in given["sections"]})
        return types.SimpleNamespace(save=lambda: types.SimpleNamespace(url="address"))

    record = lambda **given: types.SimpleNamespace(**given)  # noqa: E731
    panels = types.SimpleNamespace(LinePlot=record, BarPlot=record)
    workspaces = types.SimpleNamespace(Section=record, Workspace=keep)
    package = types.ModuleType("wandb_workspaces")
    package.workspaces = workspaces
    package.reports = types.SimpleNamespace(v2=panels)
    monkeypatch.setitem(sys.modules, "wandb_workspaces", package)
    monkeypatch.setitem(sys.modules, "wandb_workspaces.reports", package.reports)
    monkeypatch.setitem(sys.modules, "wandb_workspaces.reports.v2", panels)
    monkeypatch.setitem(sys.modules, "wandb_workspaces.workspaces", workspaces)
    return sections


def test_every_mode_gets_a_section_and_so_do_learned_values_and_results(stand_in):
    assert build_dashboard("team", "project", ["bicycle", "scooter"]) == "address"
    others = {"Learned", "Evaluation", "Closed loop", "Identification"}
    assert {"Mode: bicycle", "Mode: scooter", *others, *PANELS} == set(stand_in)
    assert "ADE [m] (val, bicycle)" in {panel.title for panel in stand_in["Mode: bicycle"]}
    assert "success" in {panel.title for panel in stand_in["Closed loop"]}


@pytest.mark.parametrize(
    "key", ["cost_weight/final_goal", "physical/wheelbase", "physical/friction/0"]
)
def test_learned_values_are_found_under_the_keys_that_are_logged(stand_in, key):
    build_dashboard("team", "project", [])
    patterns = [panel.metric_regex for panel in stand_in["Learned"]]
    assert any(re.fullmatch(pattern, key) for pattern in patterns)


def test_the_real_package_takes_the_layout():
    pytest.importorskip("wandb_workspaces", reason="needs the extra `dashboard`")
    layout = json.dumps(
        dashboard("team", "project", ["bicycle"])._to_model().model_dump(mode="json")
    )
    for told in ("val/bicycle/plan_ade", "physical/.*", "success_rate", "gradient/cost"):
        assert told in layout
