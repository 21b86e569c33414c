"""Libraries of the predictor give what tensors give, with the same gradients."""

import pytest
import torch
from torch.autograd import gradcheck

from diffstack_mmv.dynamics import DiffKBM
from diffstack_mmv.prediction import all_agents
from diffstack_mmv.prediction.trajectron import blocks
from diffstack_mmv.prediction.trajectron.agent_batch import agent_batch
from diffstack_mmv.prediction.trajectron.blocks import Blocks, Scaling
from diffstack_mmv.prediction.trajectron.decoder import ControlDecoder
from diffstack_mmv.prediction.trajectron.memory import MaskedLSTM
from diffstack_mmv.prediction.trajectron.mixture import PositionMoments
from diffstack_mmv.prediction.trajectron.paths import _fit, path_scores
from diffstack_mmv.prediction.trajectron.recurrence import Weights
from diffstack_mmv.vehicles import load_vehicle
from tests.prediction.samples import DT_S, scene

PRECISE = [(torch.float64, 1e-12), (torch.float32, 1e-4)]


def decoder(hidden, horizon, dtype):
    torch.manual_seed(0)
    made = ControlDecoder(DiffKBM(load_vehicle("bicycle"), DT_S), 2, 1, horizon, hidden=hidden)
    for head in (made.mean_head, made.scale_head):
        torch.nn.init.normal_(head.weight, std=0.5)
    return made.to(dtype)


def in_blocks(made):
    """The decoder with its recurrence in the library, and the integration by tensors."""
    made.compile_kernels(lambda *_: None)
    return made


def seen(count, dtype):
    """Context and tracks of so many agents."""
    agents = scene(batch=(count,), neighbors=0, dtype=dtype)
    rows = agent_batch(all_agents(agents.ego_past, agents.neighbors_past), DT_S)
    return torch.randn(count, 2, dtype=dtype).requires_grad_(), rows


def sloped(made, results, context, toward):
    sources = [context, *(each for each in made.parameters() if each.requires_grad)]
    return torch.autograd.grad(results, sources, toward, allow_unused=True, materialize_grads=True)


@pytest.mark.parametrize(("dtype", "tolerance"), PRECISE)
@pytest.mark.parametrize(("count", "hidden", "horizon"), [(1, 3, 4), (70, 9, 5), (67, 16, 3)])
def test_moments_are_those_of_tensors(count, hidden, horizon, dtype, tolerance):
    made = decoder(hidden, horizon, dtype)
    context, rows = seen(count, dtype)
    expected = made(context, rows)
    toward = [torch.randn_like(each) for each in expected]
    for each in toward:
        each[1::3] = 0  # rows without a gradient
    right = sloped(made, expected, context, toward)
    found = in_blocks(made)(context, rows)
    close = {"rtol": tolerance, "atol": tolerance}
    torch.testing.assert_close(found, expected, **close)
    torch.testing.assert_close(sloped(made, found, context, toward), right, **close)


def test_their_gradient_is_that_of_the_value():
    made, (context, rows) = in_blocks(decoder(3, 3, torch.float64)), seen(2, torch.float64)
    assert gradcheck(lambda context: made(context, rows), context)


def test_without_any_gradient_slopes_are_zero():
    made, (context, rows) = in_blocks(decoder(9, 3, torch.float64)), seen(5, torch.float64)
    results = made(context, rows)
    found = sloped(made, results, context, [torch.zeros_like(each) for each in results])
    assert all((slope == 0).all() for slope in found)


def paths(count, components, steps, dtype):
    torch.manual_seed(1)
    mean = torch.randn(count, components, steps, 2, dtype=dtype)
    factor = 0.3 * torch.randn(count, components, steps, 2, 2, dtype=dtype)
    covariance = factor @ factor.mT + 0.05 * torch.eye(2, dtype=dtype)
    log_weight = (2 * torch.randn(count, components, dtype=dtype)).log_softmax(-1)
    truth, valid = torch.randn(count, steps, 2, dtype=dtype), torch.rand(count, steps) < 0.8
    valid[0] = False
    learned = [each.requires_grad_() for each in (mean, covariance, log_weight)]
    return learned, truth, valid


@pytest.mark.parametrize(("dtype", "tolerance"), PRECISE)
@pytest.mark.parametrize("sizes", [(1, 1, 1), (70, 5, 30), (3, 16, 9)])
@pytest.mark.parametrize("weighed", [True, False])
def test_scores_of_paths_are_those_of_tensors(sizes, weighed, dtype, tolerance):
    (mean, covariance, log_weight), truth, valid = paths(*sizes, dtype)
    sources = [mean, covariance, *([log_weight] if weighed else [])]
    toward, results = torch.randn(sizes[:2], dtype=dtype), []
    for form in (None, Blocks()):
        moments, weight = PositionMoments(mean, covariance), log_weight if weighed else None
        scores = path_scores(moments, weight, truth, valid, form)
        whole = (toward * (scores.log_density + 3 * scores.energy.unsqueeze(-1))).sum()
        results.append((*scores, *torch.autograd.grad(whole, sources)))
    for expected, found in zip(*results, strict=True):
        scale = expected.detach().abs().max().clamp_min(1)
        torch.testing.assert_close(found / scale, expected / scale, rtol=0, atol=tolerance)


@pytest.mark.parametrize("rows", [1, 2, 5, 40])
def test_a_gradient_that_is_one_number_for_all_rows_lasts_as_long_as_the_call(rows):
    """A copy of it was given back before the library read it, and was written over at times."""
    (mean, covariance, log_weight), truth, valid = paths(rows, 3, 4, torch.float64)
    moments = PositionMoments(mean, covariance)

    def slope(toward):
        scores = path_scores(moments, log_weight.detach(), truth, valid, Blocks())
        return torch.autograd.grad(scores.energy, mean, toward)[0]

    expected = slope(torch.ones(rows, dtype=torch.float64))
    for _ in range(50):
        assert torch.equal(slope(torch.ones((), dtype=torch.float64).expand(rows)), expected)


def test_components_that_do_not_count_are_not_moved():
    (mean, covariance, _), truth, valid = paths(2, 3, 4, torch.float64)
    valid[:] = True
    log_weight = torch.tensor([0.6, 0.39, 0.01], dtype=torch.float64).log().expand(2, 3)
    scores = path_scores(PositionMoments(mean, covariance), log_weight, truth, valid, Blocks())
    (slope,) = torch.autograd.grad(scores.energy.sum(), mean)
    assert (slope[:, 2] == 0).all()
    assert (slope[:, :2] != 0).any()


def test_without_a_compiler_rows_are_left_to_tensors(monkeypatch):
    monkeypatch.setattr(blocks, "library", lambda dtype: None)
    assert not Blocks().fit(torch.zeros(2, 3))
    made, given = decoder(3, 3, torch.float32), seen(2, torch.float32)
    assert torch.equal(made(*given).mean, in_blocks(made)(*given).mean)


@pytest.mark.parametrize("field", ["covariance", "weight", "truth", "valid"])
def test_paths_of_other_sizes_are_left_to_tensors(field):
    """The library would read beyond what all rows share."""
    (mean, covariance, weight), truth, valid = paths(9, 3, 4, torch.float64)
    given = {"covariance": covariance, "weight": weight, "truth": truth, "valid": valid}

    def fits(covariance, weight, truth, valid):
        return _fit(Blocks(), PositionMoments(mean, covariance), weight, truth, valid)

    assert fits(**given)
    assert fits(**{**given, "weight": None})
    assert not fits(**{**given, field: given[field][:1]})


def test_weights_of_another_type_are_left_to_tensors():
    assert Blocks().fit(torch.zeros(2, 3), torch.zeros(2))
    assert not Blocks().fit(torch.zeros(2, 3), torch.zeros(2, dtype=torch.float64))


@pytest.mark.parametrize(
    "rows",
    [torch.zeros(2, 3).half(), torch.zeros(2, 3).bfloat16(), torch.zeros(2, 3, dtype=torch.long)]
    + [torch.zeros(0, 3), torch.zeros(2, 3, device="meta")],
    ids=["half", "bfloat16", "whole", "none", "elsewhere"],
)
def test_rows_that_no_library_takes_are_left_to_tensors(rows: torch.Tensor) -> None:
    assert not Blocks().fit(rows)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(("rows", "steps"), [(2, 4), (3, 3), (3, 5)])
def test_a_mask_of_other_rows_or_steps_is_refused(rows: int, steps: int) -> None:
    weight, mask = torch.zeros(8, 8), torch.ones(rows, steps, dtype=torch.bool)
    with pytest.raises(ValueError, match="`valid` must have the shape"):
        Blocks().last_states(torch.zeros(3, 4, 5), mask, weight)


def test_features_that_do_not_fit_the_weights_are_refused():
    memory = MaskedLSTM(5, 8)
    memory.compile_kernels()
    with pytest.raises(ValueError, match="`features` must have the shape"):
        memory(torch.zeros(3, 4, 7), torch.ones(3, 4, dtype=torch.bool))


@pytest.mark.parametrize("field", ["width", *Weights._fields])
def test_weights_that_do_not_fit_the_rows_are_refused(field):
    shapes = dict(zip(Weights._fields, [(12, 2), (12, 4), (12,), (5, 4), (5,)], strict=True))
    shapes["width"] = (2,)
    short = {
        name: torch.zeros(shape[0] - (name == field), *shape[1:]) for name, shape in shapes.items()
    }
    scaling = Scaling(short.pop("width"), 4.0, 0.25)
    rows = torch.zeros(9, 12), torch.zeros(9, 4), torch.zeros(9, 5, 2)
    with pytest.raises(ValueError, match=f"{field}` must have the shape"):
        Blocks().controls(*rows, Weights(**short), scaling)
