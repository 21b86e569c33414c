"""Means by mode do not depend on how samples are spread."""

import pandas as pd
import pytest
import torch

from diffstack_mmv.metrics import MeanByMode
from diffstack_mmv.types import Mode
from tests.metrics.samples import synced


def example(count=50):
    """Scores of which a fifth could not be judged."""
    mode = torch.tensor([Mode.BICYCLE, Mode.SCOOTER, Mode.CAR])[torch.randint(3, (count,))]
    ade = torch.rand(count).masked_fill(torch.rand(count) < 0.2, torch.nan)
    return {"ade": ade, "solved": torch.randint(2, (count,)).float()}, mode


def test_means_equal_a_group_by():
    scores, mode = example()
    metric = MeanByMode(list(scores))
    metric.update(scores, mode)
    frame = pd.DataFrame({name: value.double().numpy() for name, value in scores.items()})
    expected = frame.groupby(mode.numpy()).mean()
    means = metric.compute()
    for value, row in expected.iterrows():
        for name in scores:
            assert means[f"{Mode(value).label}/{name}"].item() == pytest.approx(row[name], rel=1e-6)
    assert means["ade"].item() == pytest.approx(frame["ade"].mean(), rel=1e-6)


@pytest.mark.parametrize("sizes", [[50], [1, 49], [7] * 7 + [1]])
def test_means_do_not_depend_on_the_batches(sizes):
    scores, mode = example()
    whole, parts = MeanByMode(list(scores)), MeanByMode(list(scores))
    whole.update(scores, mode)
    for rows in torch.arange(50).split(sizes):
        parts.update({name: value[rows] for name, value in scores.items()}, mode[rows])
    assert parts.compute() == whole.compute()


def test_states_of_two_processes_add_up():
    scores, mode = example()
    whole, one, two = (MeanByMode(list(scores)) for _ in range(3))
    whole.update(scores, mode)
    for metric, rows in ((one, slice(0, 20)), (two, slice(20, 50))):
        metric.update({name: value[rows] for name, value in scores.items()}, mode[rows])
    assert synced(one, two).compute() == whole.compute()


def test_samples_without_a_score_are_left_out_of_its_mean_and_counted():
    metric = MeanByMode(["ade", "fde"])
    nan = torch.nan
    scores = {
        "ade": torch.tensor([1.0, nan, 3.0, nan]),
        "fde": torch.tensor([nan, nan, 5.0, 4.0]),
    }
    metric.update(scores, torch.tensor([3, 3, 3, 5]))
    assert {name: float(value) for name, value in metric.compute().items()} == {
        "ade": 2.0, "bicycle/ade": 2.0,
        "fde": 4.5, "bicycle/fde": 5.0, "scooter/fde": 4.0,
        "n_missing": 3.0, "bicycle/n_missing": 2.0, "scooter/n_missing": 1.0,
    }  # fmt: skip


def test_mode_without_samples_is_absent():
    metric = MeanByMode(["ade"])
    metric.update({"ade": torch.tensor([1.0])}, torch.tensor([3]))
    assert set(metric.compute()) == {"ade", "bicycle/ade", "n_missing", "bicycle/n_missing"}


def test_a_score_that_judged_no_sample_is_absent_where_that_is_so():
    metric = MeanByMode(["ade", "fde"])
    nan = torch.nan
    scores = {"ade": torch.tensor([1.0, 2.0]), "fde": torch.tensor([nan, nan])}
    metric.update(scores, torch.tensor([3, 5]))
    assert not any("fde" in name for name in metric.compute())
    metric.update({"ade": torch.tensor([1.0]), "fde": torch.tensor([4.0])}, torch.tensor([5]))
    found = {name: float(value) for name, value in metric.compute().items() if "fde" in name}
    assert found == {"fde": 4.0, "scooter/fde": 4.0}


def test_no_score_is_refused():
    with pytest.raises(ValueError, match="`names` must hold at least one score"):
        MeanByMode([])
