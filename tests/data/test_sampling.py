"""Order of the samples."""

import pandas as pd
import pytest
import torch

from diffstack_mmv.data import EqualModes, SituationShare
from diffstack_mmv.data.sampling import EvaluationSampler, Share, TrainingSampler


def drawn(sampler):
    return [index for draw in sampler for index in draw.indices]


def training(rank=0, processes=1, epoch=0, seed=0, weights=None, count=103):
    sampler = TrainingSampler(count, 8, seed, Share(rank, processes), weights)
    sampler.set_epoch(epoch)
    return sampler


@pytest.mark.parametrize(("count", "length"), [(103, 13), (104, 13), (8, 1), (1, 1)])
def test_an_epoch_takes_every_sample_once(count, length):
    assert sorted(drawn(training(count=count))) == list(range(count))
    assert len(training(count=count)) == len(list(training(count=count))) == length


@pytest.mark.parametrize("other", [{"epoch": 4}, {"seed": 1}, {"epoch": 1, "seed": 3}])
def test_the_order_is_a_function_of_seed_and_epoch(other):
    assert drawn(training(epoch=3)) == drawn(training(epoch=3))
    assert drawn(training(epoch=3)) != drawn(training(**{"epoch": 3, **other}))


@pytest.mark.parametrize("processes", [2, 3])
def test_processes_take_disjoint_and_equally_large_shares(processes):
    shares = [drawn(training(rank, processes)) for rank in range(processes)]
    assert len({len(share) for share in shares}) == 1
    joined = sum(shares, [])
    assert len(set(joined)) == len(joined) == 103 // processes * processes


def test_two_processes_take_the_batches_that_one_process_with_twice_the_batch_takes():
    whole = TrainingSampler(96, 16, 0, Share())
    halves = [list(TrainingSampler(96, 8, 0, Share(rank, 2))) for rank in (0, 1)]
    for both, first, second in zip(whole, *halves, strict=True):
        assert set(both.indices) == {*first.indices, *second.indices}


@pytest.mark.parametrize("processes", [1, 2, 3])
def test_evaluation_takes_every_sample_once_in_order(processes):
    shares = [drawn(EvaluationSampler(103, 8, 0, Share(r, processes))) for r in range(processes)]
    assert sorted(sum(shares, [])) == list(range(103))
    assert all(share == sorted(share) for share in shares)


def test_starting_within_an_epoch_gives_the_rest_of_it():
    sampler = training(epoch=2)
    whole = list(sampler)
    sampler.start = 5
    assert list(sampler) == whole[5:]
    sampler.set_epoch(2)
    assert list(sampler) == whole[5:]
    sampler.set_epoch(3)
    assert len(list(sampler)) == len(whole)


def test_batches_have_seeds_of_their_own_in_every_epoch_and_process():
    seeds = [draw.seed for e in (0, 1) for r in (0, 1) for draw in training(r, 2, e)]
    assert len(set(seeds)) == len(seeds)


def test_a_situation_makes_up_its_share_of_the_draws():
    samples = pd.DataFrame({"moving": [True] * 100 + [False] * 900})
    weights = SituationShare("moving", 0.75).weights(samples)
    indices = torch.tensor(drawn(training(weights=weights, count=1000)))
    assert abs((indices < 100).float().mean() - 0.75) < 0.04


def test_equal_modes_draw_a_rare_mode_as_often_as_a_common_one():
    samples = pd.DataFrame({"mode": [3] * 950 + [5] * 50})
    weights = EqualModes().weights(samples)
    torch.testing.assert_close(weights[:950].sum(), weights[950:].sum())


@pytest.mark.parametrize(
    ("balance", "complaint"),
    [
        (lambda: SituationShare("flying"), "`situation` must be one of"),
        (lambda: SituationShare("moving", 1.5), "`share` must lie in"),
        (lambda: SituationShare().weights(pd.DataFrame({"mode": [1]})), "carry situations"),
        (lambda: SituationShare().weights(pd.DataFrame({"moving": [True]})), "for some samples"),
    ],
)
def test_a_balance_that_cannot_be_is_refused(balance, complaint):
    with pytest.raises(ValueError, match=complaint):
        balance()
