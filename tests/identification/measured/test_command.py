"""`identify controls=measured` on tables of one's own: no sensors but steering and speed."""

import json

import numpy as np
import pandas as pd
import pytest

WHEELBASE_M = 1.2
COLUMNS = ["+data.columns.controls.steer=steer", "+data.columns.controls.speed=speed"]


def write_rides(folder):
    """Rides of 20 s of a bicycle that weaves; its steering stands 0.02 rad beside the truth."""
    random, time_s, step_s = np.random.default_rng(0), 0.05 * np.arange(400), 0.05
    folder.mkdir()
    for ride in range(3):
        steer = 0.15 * np.sin(time_s / random.uniform(1.0, 2.5))
        speed = 4 + 0.5 * np.sin(time_s / 5 + ride)
        heading = np.cumsum(speed / WHEELBASE_M * np.tan(steer)) * step_s
        x, y = (np.cumsum(speed * way) * step_s for way in (np.cos(heading), np.sin(heading)))
        x, y = (each + random.normal(0, 0.02, len(each)) for each in (x, y))
        told = {"time": time_s, "agent": "rider", "type": "bicycle", "x": x, "y": y}
        table = pd.DataFrame(told | {"steer": steer + 0.02, "speed": speed})
        table.to_csv(folder / f"ride_{ride}.csv", index=False)


@pytest.mark.slow
@pytest.mark.parametrize("smoother", ["none", "causal"])
def test_rides_of_ones_own_are_identified_and_a_smoother_is_remarked(succeed, tmp_path, smoother):
    write_rides(tmp_path / "rides")
    data = ["data=csv", "data.name=rides", f"data.cache={tmp_path / 'cache'}"]
    root = f"data.root={tmp_path / 'rides'}"
    report = f"out={tmp_path / 'conversion'}"
    succeed("convert", *data, *COLUMNS, root, f"smoother={smoother}", report)
    out = tmp_path / "identified"
    asked = ["controls=measured", "splits=[train,val,test]", "dynamics=kbm", "others.unicycle=null"]
    succeed("identify", *data, *asked, "vehicle=bicycle", f"out={out}")
    found = json.loads((out / "identification.json").read_text())
    for ride in found["recordings"].values():
        assert ride["steer_offset"] == pytest.approx(-0.02, abs=0.004)
    warned = "The positions are smoothed (CausalSmoother"
    for file in ("identification.md", "identification.json", "identify.log"):
        assert (warned in (out / file).read_text()) == (smoother == "causal"), file
    assert "as a page: dmmv-report" in (out / "identify.log").read_text()
