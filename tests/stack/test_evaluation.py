"""Evaluation sample by sample, beside the baselines."""

import numpy as np
import pandas as pd
import pytest
import torch

from diffstack_mmv.metrics import EVALUATED, LATERAL, SPEED
from diffstack_mmv.planning import FutureGoal, PredictedGoal
from diffstack_mmv.prediction import ConstantVelocity, PathToGoal, PredictedPath, StandStill
from diffstack_mmv.prediction.goal_baselines import hermite_spline
from diffstack_mmv.stack import evaluate_windows, fitted_calibration, representative
from diffstack_mmv.types import Forecast, Mode, map_tensors
from tests.stack.test_module import STEPS, batch_of, stack_of, without_future

SCORE_OF = {"prediction": "median_ade", "plan": "plan_ade", "spline": "spline/ade"}
BASELINES = {
    "stand_still": PredictedPath(StandStill(STEPS, 0.1)),
    "spline": PathToGoal(hermite_spline),
}


class ThreeWays(ConstantVelocity):
    """The true path, and paths one and two metres beside it, with these weights."""

    weights = (0.3, 0.4, 0.3)

    def forward(self, past, neighbors):
        forecast = super().forward(past, neighbors)
        aside = torch.tensor([0.0, 1.0, 2.0])[:, None, None] * torch.tensor([0.0, 1.0])
        weight = torch.tensor(self.weights).log().expand(*forecast.log_weight.shape[:-1], 3)
        spread = forecast.scale_tril.expand(*weight.shape, STEPS, 2, 2)
        return Forecast(weight, forecast.mean + aside, spread)


class Recorded:
    """Windows of one batch."""

    def __init__(self, batch):
        self.batch = batch
        count = len(batch.goal)
        self.samples = pd.DataFrame({"scene": "a", "mode": [int(Mode.BICYCLE)] * count})

    def __len__(self):
        return len(self.samples)

    def __getitem__(self, index):
        return map_tensors(lambda field: field[list(index)], self.batch)


def test_rows_hold_every_score_and_those_of_the_baselines():
    evaluation = evaluate_windows(stack_of(PredictedGoal()), BASELINES, Recorded(batch_of()), 2)
    expected = {f"{name}/{score}" for name in BASELINES for score in ("ade", "fde")}
    costs = {name for name in evaluation.samples.columns if name.startswith("cost/")}
    expected |= {"scene", "mode", "stand_still/nll", LATERAL, SPEED, *EVALUATED}
    assert set(evaluation.samples.columns) - costs == expected
    terms = evaluation.samples[sorted(costs)].sum(axis=1)
    assert terms.to_numpy() == pytest.approx(evaluation.samples["planning_cost"], rel=1e-5)
    assert not evaluation.samples.isna().to_numpy().any()
    curves = evaluation.errors["bicycle"]
    assert set(curves) == {"prediction", "plan", *BASELINES}
    for name, score in SCORE_OF.items():
        assert curves[name].mean() == pytest.approx(evaluation.samples[score].mean(), abs=1e-6)


def test_without_plans_the_prediction_is_judged_as_it_is_beside_them():
    stack = stack_of(FutureGoal(), ThreeWays(STEPS, 0.1))
    beside, alone = (
        evaluate_windows(stack, BASELINES, Recorded(batch_of()), plans=plans)
        for plans in (True, False)
    )
    assert {"median_ade", "miss_rate", "nll", "energy_score"} < set(alone.samples.columns)
    pd.testing.assert_frame_equal(alone.samples, beside.samples[alone.samples.columns])
    assert set(beside.errors["bicycle"]) - set(alone.errors["bicycle"]) == {"plan"}
    for name, curve in alone.errors["bicycle"].items():
        assert np.array_equal(curve, beside.errors["bicycle"][name])


def test_a_path_to_a_goal_that_was_not_recorded_is_not_judged_without_plans_either():
    """It was led to whatever stands in the last row."""
    windows = Recorded(without_future(batch_of(), 1, STEPS - 2))
    for plans in (True, False):
        samples = evaluate_windows(stack_of(FutureGoal()), BASELINES, windows, plans=plans).samples
        assert np.flatnonzero(samples["spline/ade"].isna()).tolist() == [1], plans
        assert not samples["stand_still/ade"].isna().any()


def test_a_batch_is_judged_in_hindsight_once(monkeypatch):
    stack, batch, judged = stack_of(PredictedGoal()), batch_of(), []
    expected = stack.sample_scores(batch)
    judge = stack.planner.hindsight_cost
    monkeypatch.setattr(
        stack.planner, "hindsight_cost", lambda *given: judged.append(1) or judge(*given)
    )
    samples = evaluate_windows(stack, {}, Recorded(batch)).samples
    assert len(judged) == 1
    for name, value in expected.items():
        assert torch.equal(torch.from_numpy(samples[name].to_numpy()), value.detach()), name


@pytest.mark.parametrize(
    ("weights", "heaviest"),
    [((0.4, 0.3, 0.3), 0.0), ((0.3, 0.4, 0.3), 1.0), ((0.3, 0.3, 0.4), 2.0)],
)
def test_the_heaviest_component_is_scored_beside_median_and_mean(weights, heaviest):
    predictor = ThreeWays(STEPS, 0.1)
    predictor.weights = weights
    stack = stack_of(PredictedGoal(), predictor)
    samples = evaluate_windows(stack, {}, Recorded(batch_of())).samples
    assert samples["ade"].to_numpy() == pytest.approx(heaviest, abs=0.02)
    assert samples["fde"].to_numpy() == pytest.approx(heaviest, abs=0.02)
    assert samples["median_ade"].to_numpy() == pytest.approx(1.0, abs=0.15)
    mean = weights[1] + 2 * weights[2]
    assert samples["mean_ade"].to_numpy() == pytest.approx(mean, abs=0.02)
    assert samples["mean_fde"].to_numpy() == pytest.approx(mean, abs=0.02)


@pytest.mark.parametrize(("count", "enough"), [(8, False), (9, True)])
def test_a_calibration_needs_windows_enough_for_its_regions(count, enough):
    stack, windows = stack_of(PredictedGoal(), ThreeWays(STEPS, 0.1)), Recorded(batch_of(count))
    if enough:
        assert fitted_calibration(stack, windows).levels.isfinite().all()
    else:
        with pytest.raises(
            ValueError, match="`calibration.split` must hold 9 windows .* but got 8"
        ):
            fitted_calibration(stack, windows)


def test_no_score_knows_how_many_samples_were_judged_at_once():
    stack, windows = stack_of(PredictedGoal(), ThreeWays(STEPS, 0.1)), Recorded(batch_of())
    first, second = (
        evaluate_windows(stack, {}, windows, size).samples.select_dtypes("number")
        for size in (1, 3)
    )
    assert np.allclose(first, second, atol=2e-3)


@pytest.mark.parametrize("plans", [True, False])
def test_the_seed_decides_on_drawn_paths_alone(plans):
    stack, windows = stack_of(PredictedGoal(), ThreeWays(STEPS, 0.1)), Recorded(batch_of())
    first, again, other = (
        evaluate_windows(stack, {}, windows, plans=plans, seed=seed).samples for seed in (1, 1, 2)
    )
    assert first.equals(again)
    changed = {name for name in first if not first[name].equals(other[name])}
    assert {"best_of_20_ade", "energy_score"} <= changed
    assert not {"ade", "fde", "nll"} & changed


@pytest.mark.parametrize(("compile_from", "compiled"), [(3, 1), (4, 0)])
def test_kernels_are_compiled_for_many_windows_only(compile_from, compiled, monkeypatch):
    stack, calls = stack_of(PredictedGoal()), []
    monkeypatch.setattr(stack, "compile_kernels", lambda: calls.append("compiled"))
    evaluate_windows(stack, {}, Recorded(batch_of()), 3, compile_from=compile_from)
    assert len(calls) == compiled


@pytest.mark.parametrize(
    ("goal", "spline"),
    [(PredictedGoal(), True), (FutureGoal(), False)],
    ids=["predicted", "future"],
)
def test_a_sample_that_ends_early_is_missing_where_it_counts(goal, spline):
    batch = without_future(batch_of(), 1, STEPS - 2)
    evaluation = evaluate_windows(stack_of(goal), BASELINES, Recorded(batch), 3)
    row = evaluation.samples.iloc[1]
    assert np.isfinite(row["stand_still/ade"])
    assert np.isnan(row["stand_still/fde"])
    assert np.isfinite(row["spline/ade"]) == np.isfinite(row["plan_ade"]) == spline
    others = evaluation.samples.iloc[[0, 2]].drop(columns=["scene", "mode"])
    assert np.isfinite(others.to_numpy(float)).all()
    assert all(np.isfinite(curve).all() for curve in evaluation.errors["bicycle"].values())
    assert evaluation.errors["bicycle"]["prediction"].max() < 0.01


def test_nobody_recorded_at_a_time_leaves_a_gap_in_the_curve():
    batch = without_future(batch_of(count=1), 0, STEPS - 1)
    curve = evaluate_windows(stack_of(PredictedGoal()), {}, Recorded(batch)).errors["bicycle"]
    assert np.isnan(curve["prediction"]).tolist() == [False] * (STEPS - 1) + [True]


@pytest.mark.parametrize(
    ("unjudged", "chosen"),
    [
        ([], {"best": 2, "median": 3, "worst": 1}),
        ([1], {"best": 2, "median": 3, "worst": 3}),
        ([1, 2, 3], {"best": 0, "median": 0, "worst": 0}),
    ],
)
def test_representative_samples_are_judged_and_in_motion_where_there_are_such(unjudged, chosen):
    frame = pd.DataFrame(
        {
            "mode": ["bicycle"] * 4 + ["scooter", "car"],
            "moving": [False, True, True, True, False, True],
            "plan_ade": [0.0, 3.0, 1.0, 2.0, 0.5, np.nan],
        }
    )
    frame.loc[unjudged, "plan_ade"] = np.nan
    found = representative(frame)
    assert found["bicycle"] == chosen
    assert set(found["scooter"].values()) == {4}
    assert "car" not in found
