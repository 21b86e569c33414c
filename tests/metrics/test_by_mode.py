"""Means by mode do not depend on how samples are spread."""

import pandas as pd
import pytest
import torch

from diffstack_mmv.metrics import MeanByMode
from diffstack_mmv.types import Mode


def example(count=50):
    mode = torch.tensor([Mode.BICYCLE, Mode.SCOOTER, Mode.CAR])[torch.randint(3, (count,))]
    return {"ade": torch.rand(count), "solved": torch.randint(2, (count,)).float()}, mode


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
    assert all(
        reduction is torch.sum or "sum" in str(reduction) for reduction in one._reductions.values()
    )
    one.total += two.total
    one.count += two.count
    assert one.compute() == whole.compute()


def test_sample_without_a_score_is_left_out_of_its_mean():
    metric = MeanByMode(["ade"])
    metric.update({"ade": torch.tensor([1.0, float("nan"), 3.0])}, torch.tensor([3, 3, 3]))
    assert metric.compute()["bicycle/ade"] == 2.0


def test_mode_without_samples_is_absent():
    metric = MeanByMode(["ade"])
    metric.update({"ade": torch.tensor([1.0])}, torch.tensor([3]))
    assert set(metric.compute()) == {"ade", "bicycle/ade"}
