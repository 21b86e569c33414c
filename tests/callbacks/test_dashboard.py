"""The dashboard: built from keys that training really logs."""

import sys
import types

import pytest

from diffstack_mmv.callbacks import build_dashboard
from diffstack_mmv.callbacks.dashboard import PANELS


def test_without_the_extra_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb_workspaces", None)
    with pytest.raises(ImportError, match=r"diffstack_mmv\[dashboard\]"):
        build_dashboard("team", "project", ["bicycle"])


def test_every_mode_gets_a_section(monkeypatch):
    sections = {}

    def keep(**given):
        sections.update({section.name: section.panels for section in given["sections"]})
        return types.SimpleNamespace(save=lambda: types.SimpleNamespace(url="address"))

    record = lambda **given: types.SimpleNamespace(**given)  # noqa: E731
    panels = types.SimpleNamespace(LinePlot=record)
    workspaces = types.SimpleNamespace(Section=record, Workspace=keep)
    package = types.ModuleType("wandb_workspaces")
    package.workspaces = workspaces
    package.reports = types.SimpleNamespace(v2=panels)
    monkeypatch.setitem(sys.modules, "wandb_workspaces", package)
    monkeypatch.setitem(sys.modules, "wandb_workspaces.reports", package.reports)
    monkeypatch.setitem(sys.modules, "wandb_workspaces.reports.v2", panels)
    monkeypatch.setitem(sys.modules, "wandb_workspaces.workspaces", workspaces)
    assert build_dashboard("team", "project", ["bicycle", "scooter"]) == "address"
    assert {"Mode: bicycle", "Mode: scooter", *PANELS} == set(sections)
    assert "ADE [m] (val, bicycle)" in {panel.title for panel in sections["Mode: bicycle"]}
