"""Splits joined to one."""

import pandas as pd
import pytest
import torch

from diffstack_mmv.data import JoinedWindows, WindowDataset
from diffstack_mmv.types import map_tensors
from tests.prediction.samples import scene


class Held(WindowDataset):
    """Samples in memory."""

    def __init__(self, batch):
        self.batch = batch

    def __len__(self):
        return len(self.batch.goal)

    def __getitem__(self, index):
        # plain numbers, as the annotation says, not those of numpy
        assert all(type(number) is int for number in index)
        return map_tensors(lambda field: field[list(index)], self.batch)

    @property
    def samples(self):
        return pd.DataFrame({"row": range(len(self))})


@pytest.mark.parametrize("index", [[0], [4, 1, 3, 0], [2, 3], [0, 1, 2, 3, 4]])
def test_samples_come_in_the_order_in_which_they_are_asked_for(index):
    first, second = scene(batch=(2,), neighbors=1), scene(batch=(3,), neighbors=3)
    joined = JoinedWindows([Held(first), Held(second)])
    found = joined[index]
    goals = torch.cat([first.goal, second.goal])
    assert len(joined) == 5
    assert torch.equal(found.goal, goals[index])
    assert torch.equal(found.ego_future.motion.position[:, -1], goals[index])


def test_absent_neighbors_are_zero_and_not_valid():
    first, second = scene(batch=(2,), neighbors=1), scene(batch=(3,), neighbors=3)
    found = JoinedWindows([Held(first), Held(second)])[[0, 4]]
    assert found.neighbors_past.valid[:, :, -1].tolist() == [[True, False, False], [True] * 3]
    assert found.neighbors_past.motion.position[0, 1:].abs().max() == 0.0


def test_the_rows_of_all_are_told():
    joined = JoinedWindows([Held(scene(batch=(2,))), Held(scene(batch=(3,)))])
    assert joined.samples["row"].tolist() == [0, 1, 0, 1, 2]


def test_nothing_cannot_be_joined():
    with pytest.raises(ValueError, match="`parts` must hold at least one data set"):
        JoinedWindows([])
