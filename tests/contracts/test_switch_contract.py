"""Switches of what users build take true and false, and no text, which would count as true."""

import re
from pathlib import Path

import pytest

from data_converters.imptc.reader import TrackFilter
from data_converters.tables.units import TableUnits
from data_converters.tracks import ResampleSettings
from diffstack_mmv.callbacks import WandbResults
from diffstack_mmv.control import ILQR
from diffstack_mmv.control.constrained import ConstrainedILQR
from diffstack_mmv.data import ExportSettings
from diffstack_mmv.identification.measured.fit import MeasuredFitter
from diffstack_mmv.identification.shooting import MultipleShooting
from diffstack_mmv.online import OnlineStack
from diffstack_mmv.planning import CandidateFan, DetourFan, PlanConstraints, PlanPrice
from diffstack_mmv.simulation import CrowdNavEnv, OrcaForecaster
from diffstack_mmv.vehicles import ParameterSpec, WheelSpec

WHEEL = {"name": "front", "x_m": 0.5, "y_m": 0.0, "radius_m": 0.3}
PARAMETER = {"initial": 1.0, "low": 0.0, "high": 2.0, "unit": "1", "learn": True, "source": "x"}


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("part", "switch", "others"),
    [
        (ILQR, "compile", {}),
        (ConstrainedILQR, "persistent", {}),
        (CandidateFan, "compile", {}),
        (DetourFan, "compile", {}),
        (PlanPrice, "compile", {}),
        (PlanConstraints, "persistent", {"limits": {}}),
        (CrowdNavEnv, "robot_visible", {}),
        (OrcaForecaster, "observed_speed", {}),
        (OnlineStack, "compiled", {"checkpoint": "absent.ckpt"}),
        (MultipleShooting, "restart", {}),
        (MeasuredFitter, "with_gyro", {}),
        (ExportSettings, "progress", {"folder": Path("exports")}),
        (WandbResults, "offline", {"save_dir": "runs", "project": "p", "kind": "evaluate"}),
        (WheelSpec, "driven", WHEEL),
        (ParameterSpec, "tied", PARAMETER),
        (TrackFilter, "utm", {}),
        (TableUnits, "y_down", {}),
        (ResampleSettings, "backfill_heading", {}),
    ],
)
def test_text_in_place_of_a_switch_is_refused(part, switch, others):
    told = re.escape(f"{switch}` must be true or false, but got 'no'")
    with pytest.raises(ValueError, match=told):
        part(**others, **{switch: "no"})
