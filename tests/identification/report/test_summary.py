"""What is written about an identification."""

import json
from dataclasses import asdict

import numpy as np
import pytest
import torch

from diffstack_mmv.identification import (
    BilevelFit,
    IdentifiabilityThresholds,
    Identifier,
    MultipleShooting,
    TrackingSettings,
    lean_agreement,
    summarise,
    tracking_losses,
    validation_errors,
)
from diffstack_mmv.plotting import (
    FittedTrack,
    draw_controls,
    draw_spectrum,
    save_identification,
)
from diffstack_mmv.plotting.identification import draw_tracks
from diffstack_mmv.reporting import write_identification
from tests.identification.conftest import LIVELY, synthetic_problem
from tests.identification.report.conftest import leaning

CONTRACT = {"tracks", "loss_before", "loss_after", "heldout_before", "heldout_after", "parameters"}
ENTRY = {"initial", "estimate", "low", "high", "unit", "std", "identifiability"}
HEADER = {"vehicle": "bicycle", "dynamics": "kbm", "data": "toy", "mode": "shooting", "seed": 0}


def test_summary_holds_the_keys_that_others_rely_on(result):
    summary = result[2]
    assert set(summary) >= CONTRACT
    assert set(summary["parameters"]["wheelbase"]) >= ENTRY
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary


def test_report_tells_parameters_models_and_remarks(result, tmp_path):
    setup, found, summary = result
    models = {"kbm": tracking_losses(setup.simulator, setup.data, found)}
    write_identification(tmp_path, HEADER | summary | {"models": models})
    text = (tmp_path / "identification.md").read_text()
    assert "wheelbase" in text
    assert "identifiable" in text
    assert "Influence of the regularisation" in text
    assert json.loads((tmp_path / "identification.json").read_text())["seed"] == 0


@pytest.mark.parametrize(
    ("verdict", "told"),
    [
        ("identifiable", "Identifiable: wheelbase (of 1 parameters)."),
        ("weakly identifiable", "Identifiable: none (of 1 parameters)."),
        ("not identifiable", "The tracks inform no parameter"),
    ],
)
def test_report_begins_with_how_many_parameters_are_informed(result, tmp_path, verdict, told):
    summary = result[2]
    parameters = {"wheelbase": summary["parameters"]["wheelbase"] | {"verdict": verdict}}
    changed = HEADER | summary | {"models": {}, "parameters": parameters}
    write_identification(tmp_path, changed)
    assert told in (tmp_path / "identification.md").read_text()


def test_figures_are_drawn(result, tmp_path):
    setup, found, summary = result
    tracks = [FittedTrack(**motion.arrays()) for motion in setup.fitted_motions(found)]
    shown = summary | {"profiles": {"wheelbase": {"values": [1.0, 1.1], "costs": [3.0, 1.0]}}}
    save_identification(tmp_path, shown, tracks, ("acceleration", "steer"), 0.1)
    drawn = {path.name for path in tmp_path.glob("*.png")}
    assert drawn == {
        f"{n}.png" for n in ["tracks", "controls", "parameters", "spectrum", "profiles"]
    }


def test_controls_have_units_and_their_tracks_a_line_of_their_own():
    line = np.zeros((3, 2))
    tracks = [FittedTrack(f"track {index}", line, line, line) for index in range(12)]
    figure = draw_controls(tracks, ("acceleration", "steer"), 0.1)
    assert [axes.get_ylabel() for axes in figure.axes] == ["acceleration [m/s²]", "steer [rad]"]
    lines = figure.axes[0].get_lines()
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 12
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [each.name for each in tracks]


def test_few_tracks_fill_the_figure_and_a_legend_tells_fit_from_recording():
    line = np.zeros((3, 2))
    figure = draw_tracks([FittedTrack(f"track {index}", line, line, line) for index in range(4)])
    assert [axes.get_gridspec().ncols for axes in figure.axes] == [4] * 4
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["recorded", "fit"]


def test_directions_without_information_are_marked_as_such():
    (axes,) = draw_spectrum([2.0, 1e-5, 1e-17, -1e-18]).axes
    told, none, prior = axes.get_lines()
    assert list(told.get_ydata()) == [2.0, 1e-5]
    assert list(none.get_ydata()) == [1e-6, 1e-6]
    assert none.get_label() == "none: below 1e-06"
    assert "none" not in str(draw_spectrum([2.0, 1.0]).axes[0].get_legend().get_texts())
    assert prior.get_label() == "information of the prior"


def test_report_tells_what_was_assumed_and_what_was_held_out(result, tmp_path):
    setup, found, summary = result
    models = {"kbm": tracking_losses(setup.simulator, setup.data, found)}
    heldout = validation_errors(setup, found, Identifier(), 5)
    judged = {"kbm": heldout.pooled() | heldout.change_from(heldout)}
    extra = {
        "models": models,
        "assumed": asdict(TrackingSettings()),
        "beyond_limits": 0.07,
        "validation": {"folds": 4, "stretches": 1, "foresee_s": 0.5, "models": judged},
        "lean": lean_agreement([leaning(torch.rand(30), torch.rand(30))], 0.1),
    }
    write_identification(tmp_path, HEADER | summary | extra)
    text = (tmp_path / "identification.md").read_text()
    for part in ("In 7 % of the samples", "each held out once in 4 folds", "3.00 m/s³", "s late"):
        assert part in text


def test_report_of_a_lean_that_does_not_vary_tells_so(result, tmp_path):
    setup, found, summary = result
    models = {"kbm": tracking_losses(setup.simulator, setup.data, found)}
    lean = lean_agreement([leaning(torch.rand(30), torch.zeros(30))], 0.1)
    write_identification(tmp_path, HEADER | summary | {"models": models, "lean": lean})
    told = (tmp_path / "identification.md").read_text()
    assert "One of them does not vary: there is no correlation." in told


def test_model_without_parameters_only_follows_tracks():
    setup = synthetic_problem("unicycle", {}, known=False, manoeuvres=LIVELY[:1])
    found = Identifier(BilevelFit())(setup.simulator, setup.data)
    summary = summarise(setup.simulator, setup.data, found, IdentifiabilityThresholds())
    assert summary["parameters"] == {}
    assert summary["loss_before"] == summary["loss_after"]


@pytest.mark.filterwarnings("error::UserWarning")
def test_parameters_that_are_left_out_do_not_warn():
    setup = synthetic_problem("gm3", {}, manoeuvres=LIVELY[:1], parameters=["tread_stiffness"])
    found = Identifier(MultipleShooting(max_iterations=1), starts=0)(setup.simulator, setup.data)
    summary = summarise(setup.simulator, setup.data, found, IdentifiabilityThresholds())
    assert any(entry["std"] > 0 for entry in summary["combinations"].values())
