"""On a device the solver asks the host for nothing but whether all problems are finished.

The meta device has shapes and no values: whatever waits for a value is caught there.
"""

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from diffstack_mmv.control import ILQR, Batched, Bounds, DifferencedCurvature
from diffstack_mmv.control.ilqr import CHECK_EVERY
from diffstack_mmv.dynamics import DiffGM3, DiffKBM, ExtendedUnicycle
from diffstack_mmv.vehicles import load_vehicle
from tests.control.test_linear_quadratic import affine, quadratic

WAITING = {
    *("_local_scalar_dense", "is_nonzero", "equal"),  # .item(), bool(), ==
    *("nonzero", "nonzero_numpy", "masked_select", "repeat_interleave"),
    *("unique", "_unique2", "unique_dim", "unique_consecutive", "bincount"),
    "_linalg_check_errors",
}
"""Operations whose result, or its shape, the host has to wait for."""
EVERY = 4  # iterations between two questions on a device


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
        fetched = name == "_to_copy" and (kwargs or {}).get("device") == torch.device("cpu")
        if name not in WAITING and not by_mask and not fetched:
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


@pytest.mark.parametrize(
    "name", [pytest.param(each, marks=SLOW.get(each, ())) for each in PROBLEMS]
)
def test_the_only_question_is_whether_all_are_finished(name, monkeypatch):
    dynamics, cost, box, n = PROBLEMS[name]()
    curvature = {"curvature": DifferencedCurvature()} if name == "gm3" else {}
    iterations = 5 if name == "kbm" else 1
    solver = ILQR(max_iterations=iterations, **curvature)
    state, m = torch.empty(20, n, device="meta"), len(box.lower)
    guess = torch.empty(20, 2, m, device="meta")
    monkeypatch.setattr("diffstack_mmv.control.ilqr.check_problem", lambda *_: None)  # asks once
    assert CHECK_EVERY.get("meta", EVERY) == EVERY
    state.requires_grad_()
    with Waits() as waits:
        solution = solver(dynamics, cost, box, state, guess)
        torch.autograd.grad(solution.controls.square().sum(), state)
    assert solution.controls.shape == (20, 2, m)
    assert waits.seen == ["_local_scalar_dense"] * -(-iterations // EVERY)


WAITS = {
    "index": lambda values: values[values > 0],
    "index_put_": lambda values: values.__setitem__(values > 0, 0.0),
    "nonzero": lambda values: torch.where(values > 0),
    "masked_select": lambda values: values.masked_select(values > 0),
    "equal": lambda values: torch.equal(values, values + 1),
    "_unique2": lambda values: values.unique(),
    "repeat_interleave": lambda values: values.repeat_interleave(values.long()),
    "_to_copy": lambda values: values.to("cpu"),
}


@pytest.mark.parametrize("name", WAITS)
def test_a_wait_is_seen(name):
    with Waits() as waits, pytest.raises(AssertionError, match=f"{name} waits"):
        WAITS[name](torch.empty(4, device="meta"))
    assert waits.seen == [name]


@pytest.mark.parametrize("ask", [bool, float, torch.Tensor.item])
def test_a_question_is_counted(ask):
    with Waits() as waits:
        ask(torch.empty((), device="meta"))
    assert waits.seen == ["_local_scalar_dense"]
