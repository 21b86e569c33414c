"""A training step on a GPU gives what it gives on a CPU, with libraries and on tensors."""

import pytest
import torch

from diffstack_mmv.control.native.moments import moments
from diffstack_mmv.control.native.scan import scan
from diffstack_mmv.dynamics import DiffKBM, ExtendedUnicycle, rollout
from diffstack_mmv.planning import PredictedGoal
from diffstack_mmv.prediction.trajectron.memory import MaskedLSTM
from diffstack_mmv.types import map_tensors
from diffstack_mmv.vehicles import load_vehicle
from tests.prediction.samples import DT_S, scene, trajectron
from tests.stack.test_module import stack_of

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU of CUDA"),
]
STEPS = 8


def there(record):
    return map_tensors(lambda field: field.cuda(), record)


def step(device, compiled):
    """Loss, plans and gradients of a step by name; without one, as without rows, it is zero."""
    torch.manual_seed(0)
    batch = scene(batch=(6,), horizon=STEPS, dtype=torch.float64)
    stack = stack_of(PredictedGoal(), None, steps=STEPS)
    stack.predictor = trajectron(stack.planner.dynamics, horizon=STEPS)
    stack = stack.double()
    if compiled:
        stack.compile_kernels()
    stack.log_dict = lambda *_, **__: None
    stack, batch = stack.to(device), map_tensors(lambda field: field.to(device), batch)
    loss = stack.training_step(batch, 0)
    loss.backward()
    with torch.no_grad():
        found = {"loss": loss, "plan": stack(batch).plan.motion.position}
    for name, each in stack.named_parameters():
        found[name] = torch.zeros_like(each) if each.grad is None else each.grad
    return {name: each.detach().cpu() for name, each in found.items()}


@pytest.mark.filterwarnings("error:RNN module weights")
@pytest.mark.parametrize("compiled", [False, True])
def test_loss_plans_and_gradients_are_those_of_a_cpu(compiled):
    found, expected = step("cuda", compiled), step("cpu", compiled)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("model", [DiffKBM, ExtendedUnicycle])
def test_libraries_take_copies_and_give_back_what_is_on_the_device(model):
    made = model(load_vehicle("bicycle"), DT_S).double()
    start = torch.rand(5, 4, dtype=torch.float64)
    controls = 0.1 * torch.randn(5, STEPS, 2, dtype=torch.float64)
    expected = rollout(made, start, controls)
    given = made.cuda(), *there((start, controls))
    found = scan(lambda state, control: (given[0].step(state, control), state), *given[1:])
    assert found is not None
    assert found.states.is_cuda
    torch.testing.assert_close(found.states.cpu(), expected)


def test_moments_and_their_gradients_are_those_of_a_cpu():
    def of(device):
        torch.manual_seed(0)
        made = DiffKBM(load_vehicle("bicycle"), DT_S).double().to(device)
        start = torch.rand(9, 4, dtype=torch.float64)
        covariance = 0.01 * torch.eye(4, dtype=torch.float64).repeat(9, 1, 1)
        controls = 0.1 * torch.randn(9, STEPS, 2, dtype=torch.float64)
        scale = 0.1 * torch.eye(2, dtype=torch.float64).repeat(9, STEPS, 1, 1)
        rows = [each.to(device).requires_grad_() for each in (start, covariance, controls, scale)]
        found = moments(made, *rows)
        slopes = torch.autograd.grad(sum(each.square().sum() for each in found), rows)
        return [each.detach().cpu() for each in (*found, *slopes)]

    for one, other in zip(of("cuda"), of("cpu"), strict=True):
        torch.testing.assert_close(one, other)


def test_the_memory_of_tracks_with_gaps_is_that_of_a_cpu():
    lstm, features = MaskedLSTM(3, 5).double(), torch.randn(40, 6, 3, dtype=torch.float64)
    valid = torch.rand(40, 6) > 0.4
    expected = lstm(features, valid)
    found = lstm.cuda()(features.cuda(), valid.cuda())
    torch.testing.assert_close(found.cpu(), expected)
