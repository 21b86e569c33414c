"""On a device the solver asks the host for nothing but whether all problems are finished.

The meta device has shapes and no values: whatever waits for a value is caught there. So are numbers
that the host sends, because a copy from memory that is not pinned waits as well.
"""

import pytest
import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from diffstack_mmv.control import ILQR, Batched, Bounds, DifferencedCurvature, compilation
from diffstack_mmv.control.ilqr import CHECK_EVERY
from diffstack_mmv.dynamics import DiffGM3, DiffKBM, ExtendedUnicycle
from diffstack_mmv.types import SolverStatus
from diffstack_mmv.vehicles import load_vehicle
from tests.control.test_linear_quadratic import affine, quadratic

WAITING = {
    *("_local_scalar_dense", "is_nonzero", "equal"),  # .item(), bool(), ==
    *("nonzero", "nonzero_numpy", "masked_select", "repeat_interleave"),
    *("unique", "_unique2", "unique_dim", "unique_consecutive", "bincount"),
    *("_linalg_check_errors", "_linalg_eigh"),
}
"""Operations whose result, or its shape, the host has to wait for."""
SENDING = {torch.tensor, torch.as_tensor, torch.asarray, torch.Tensor.new_tensor}
"""Functions that make a tensor of numbers of the host; below them no dispatch is seen."""
INDEXING = {torch.Tensor.__getitem__, torch.Tensor.__setitem__}
EVERY = 4  # iterations between two questions on a device


class Sends(TorchFunctionMode):
    """Refuses numbers of the host that are sent to a device."""

    def __torch_function__(self, func, types, args=(), kwargs=None):
        found = func(*args, **(kwargs or {}))
        sent = args[1] if func is torch.Tensor.new_tensor else args[0] if args else None
        if func in SENDING and found.device.type != "cpu" and not isinstance(sent, torch.Tensor):
            raise AssertionError(f"{func.__name__} waits for the device")
        if func in INDEXING and args[0].device.type != "cpu":
            index = args[1] if isinstance(args[1], tuple) else (args[1],)
            if any(isinstance(each, list) for each in index):
                raise AssertionError("index by a list waits for the device")
        return found


class Waits(TorchDispatchMode):
    """Counts what waits for a device; to a question it answers yes."""

    def __init__(self):
        super().__init__()
        self.seen = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = func.overloadpacket.__name__
        by_mask = name in ("index", "index_put", "index_put_") and any(
            each is not None and each.dtype in (torch.bool, torch.uint8) for each in args[1]
        )
        ends = [each.device.type for each in args[:2] if isinstance(each, torch.Tensor)]
        if name == "_to_copy" and (kwargs or {}).get("device") is not None:
            ends.append(kwargs["device"].type)
        crosses = name in ("_to_copy", "copy_") and "cpu" in ends and len(set(ends)) > 1
        if name not in WAITING and not by_mask and not crosses:
            return func(*args, **(kwargs or {}))
        self.seen.append(name)
        if name != "_local_scalar_dense":
            raise AssertionError(f"{name} waits for the device")
        return True


def linear(n, m, count):
    """Linear dynamics and a quadratic cost on the meta device."""
    A, B = torch.empty(count, n, n, device="meta"), torch.empty(count, n, m, device="meta")
    b, H = torch.empty(count, n, device="meta"), torch.empty(count, n + m, n + m, device="meta")
    box = Bounds(torch.empty(m, device="meta"), torch.empty(m, device="meta"))
    return Batched(affine, A, B, b), Batched(quadratic, H), box, n


def vehicle(model):
    """A vehicle to a goal, on the meta device."""
    model = model(load_vehicle("bicycle")).to("meta")

    def cost(states, controls, goal):
        offset = model.motion(states, controls).position - goal.unsqueeze(-2)
        return offset.square().sum(-1) + controls.square().sum(-1)

    return (
        Batched(model),
        Batched(cost, torch.empty(20, 2, device="meta")),
        model.bounds,
        model.state_dim,
    )


PROBLEMS = {
    "kbm": lambda: vehicle(DiffKBM),
    "gm3": lambda: vehicle(DiffGM3),
    "unicycle": lambda: vehicle(ExtendedUnicycle),
    **{f"{m} controls": lambda m=m: linear(5, m, 20) for m in (1, 2, 4)},
}

SLOW = {"gm3": pytest.mark.slow}


def waits_of(name, iterations, compile=False):
    """What the solve and the gradient of a problem wait for."""
    dynamics, cost, box, n = PROBLEMS[name]()
    curvature = {"curvature": DifferencedCurvature()} if name == "gm3" else {}
    solver = ILQR(max_iterations=iterations, compile=compile, **curvature)
    state, m = torch.empty(20, n, device="meta"), len(box.lower)
    guess = torch.empty(20, 2, m, device="meta")
    state.requires_grad_()
    with Waits() as waits, Sends():
        solution = solver(dynamics, cost, box, state, guess)
        torch.autograd.grad(solution.controls.square().sum(), state)
    assert solution.controls.shape == (20, 2, m)
    return waits.seen


@pytest.mark.parametrize(
    "name", [pytest.param(each, marks=SLOW.get(each, ())) for each in PROBLEMS]
)
def test_the_only_question_is_whether_all_are_finished(name):
    assert CHECK_EVERY.get("meta", EVERY) == EVERY
    iterations = 5 if name == "kbm" else 1
    assert waits_of(name, iterations) == ["_local_scalar_dense"] * -(-iterations // EVERY)


@pytest.mark.parametrize("name", ["unicycle", pytest.param("gm3", marks=pytest.mark.slow)])
def test_with_compiled_kernels_there_is_no_other_question(name, monkeypatch):
    """What is around the kernels is the same Python; they themselves run here as they are."""
    called = set()

    def as_it_is(kernel, *given):
        called.add(kernel.function.__name__)
        return kernel.function(*given)

    monkeypatch.setattr(compilation.Kernel, "__call__", as_it_is)
    assert waits_of(name, 1, compile=True) == ["_local_scalar_dense"]
    assert {"attempt", "box_policy"} < called


def test_crossed_bounds_end_every_problem_where_they_are_not_asked_for(monkeypatch):
    monkeypatch.setattr("diffstack_mmv.control.ilqr.on_host", lambda *_: False)
    A, B, b = torch.eye(2).expand(3, 2, 2), torch.ones(3, 2, 1), torch.zeros(3, 2)
    box = Bounds(torch.tensor([1.0]), torch.tensor([-1.0]))
    problem = Batched(affine, A, B, b), Batched(quadratic, torch.eye(3).expand(3, 3, 3)), box
    state, guess = torch.ones(3, 2, requires_grad=True), torch.zeros(3, 4, 1)
    solution = ILQR()(*problem, state, guess)
    assert solution.status.tolist() == [SolverStatus.INFEASIBLE] * 3
    (gradient,) = torch.autograd.grad(solution.controls.sum(), state)
    assert not gradient.any()


WAITS = {
    "index": lambda values: values[values > 0],
    "index_put_": lambda values: values.__setitem__(values > 0, 0.0),
    "nonzero": lambda values: torch.where(values > 0),
    "masked_select": lambda values: values.masked_select(values > 0),
    "equal": lambda values: torch.equal(values, values + 1),
    "_unique2": lambda values: values.unique(),
    "repeat_interleave": lambda values: values.repeat_interleave(values.long()),
    "_to_copy": lambda values: values.to("cpu"),
    "_linalg_eigh": lambda values: torch.linalg.eigvalsh(values.expand(4, 4)),
    "copy_": lambda values: values.copy_(torch.ones(4)),
}


@pytest.mark.parametrize("name", WAITS)
def test_a_wait_is_seen(name):
    with Waits() as waits, pytest.raises(AssertionError, match=f"{name} waits"):
        WAITS[name](torch.empty(4, device="meta"))
    assert waits.seen == [name]


SENT = {
    "tensor": lambda values: torch.tensor([1.0, 2.0], device=values.device),
    "new_tensor": lambda values: values.new_tensor([1.0, 2.0]),
    "index by a list": lambda values: values[[0, 2]],
}


@pytest.mark.parametrize("name", SENT)
def test_what_is_sent_is_seen(name):
    with Sends(), pytest.raises(AssertionError, match=f"{name} waits"):
        SENT[name](torch.empty(4, device="meta"))


@pytest.mark.parametrize("ask", [bool, float, torch.Tensor.item])
def test_a_question_is_counted(ask):
    with Waits() as waits:
        ask(torch.empty((), device="meta"))
    assert waits.seen == ["_local_scalar_dense"]
