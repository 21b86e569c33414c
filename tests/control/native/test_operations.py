"""Every tensor operation and its derivative in scalars are what torch says, kinks included."""

import math

import pytest
import torch

from diffstack_mmv.control.native.core_forms import decompositions
from diffstack_mmv.control.native.derivative import RULES, gradient
from diffstack_mmv.control.native.lowering import CannotLowerError, Lowering
from diffstack_mmv.control.native.operations import HANDLERS
from diffstack_mmv.control.native.scalar import CONSTANT, FOLDS, LEAF, Program, needed

VALUES = [[-0.7, 0.0, 0.4], [0.9, 0.4, -0.2]]
FUNCTIONS = {
    "arithmetic": lambda a: 2 - a * (a + 1) / (a.square() + 1) - a.neg(),
    "powers": lambda a: (a + 2) ** 3 - (a + 2) ** 1.7 + (a + 2) ** -0.5 + (a + 2).rsqrt() + a**4,
    "circular": lambda a: a.sin() * a.cos() + a.tan() + torch.atan2(a, a + 3),
    "inverse": lambda a: (0.5 * a).asin() + (0.5 * a).acos() + a.atan(),
    "hyperbolic": lambda a: a.sinh() - a.cosh() * a.tanh() + a.sigmoid() + a.atanh(),
    "logarithms": lambda a: (a + 2).log() + (a + 2).log1p() + a.exp() + a.expm1() + a.erf(),
    "softplus": lambda a: torch.nn.functional.softplus(a / 0.05),
    "kinks": lambda a: a.abs() + a.relu() + a.sign() + a.clamp(-0.2, 0.4) + a.clamp_min(0.4),
    "extremes": lambda a: torch.maximum(a[0], a[1]) * torch.minimum(a[0], a[1]),
    "largest": lambda a: a.amax(-1) - a.amin(0, keepdim=True).sum(),
    "choices": lambda a: torch.where((a > 0) & ~(a >= 0.9) | (a == 0), a.sin(), a.square()),
    "one number": lambda a: (
        torch.where(a[0, 0] < 0, a[0, 1].cos(), a[1, 0]) + a[1, 1] * (a[0, 2] > 0).to(torch.bool)
    ),
    "truths": lambda a: a * (a > 0) + (a < 0).to(a).sum(),
    "nothing": lambda a: a + a[:, :0].sum(-1, keepdim=True) + a[:0].sum(0),
    "sums": lambda a: a.sum(-1) + a.mean() + a.prod(-1) + a.norm(dim=-1),
    "divided with a rest": lambda a: (
        torch.fmod(3 * a, a.flip(0) + 0.35) + torch.remainder(a, a.flip(0) + 0.35)
    ),
    "powers of zero": lambda a: a.relu() ** (a.flip(0) + 0.3) + (a + 2) ** (0 * a),
    "losses": lambda a: (
        torch.nn.functional.huber_loss(a, a.flip(0), delta=0.3)
        + torch.nn.functional.smooth_l1_loss(a, a.flip(0), reduction="sum", beta=0.3)
        + torch.nn.functional.smooth_l1_loss(a, a.flip(0), beta=0.0)
    ),
    "rounding": lambda a: torch.fmod(a, 0.3) + torch.remainder(a, 0.3) + a.floor() * a + a.ceil(),
    "softmax": lambda a: torch.softmax(a, -1) * a,
    "products": lambda a: a @ a.mT @ a,
    "views": lambda a: torch.cat([a[:, 1:], a.unsqueeze(0).flip(-1)[0, :, :2]], -1).mT.reshape(
        4, 2
    ),
    "parts": lambda a: (
        torch.stack(a.unbind(-1)[:2], -1) * torch.stack(a.split(1, -1)[1:], -1)[:, 0]
    ),
    "padded": lambda a: torch.nn.functional.pad(a, (0, 1, 1, 0)) + 1,
    "chosen": lambda a: a[:, torch.tensor([2, 0])] + a.index_select(-1, torch.tensor([1, 1])),
    "rolled": lambda a: a.cumsum(-1) + torch.arange(3) + torch.full_like(a, 2.0) + a.expand(2, 3),
}


def run(program, wanted, leaves):
    """Values of nodes."""
    values = {}
    for node in needed(program, wanted):
        name, *arguments = program.operations[node]
        if name == LEAF:
            values[node] = leaves[tuple(arguments)]
        elif name == CONSTANT:
            values[node] = arguments[0]
        else:
            values[node] = _computed(name, *(values[each] for each in arguments))
    return [values[node] for node in wanted]


def _computed(name, *arguments):
    """An operation as a processor does it: what is too large is infinite."""
    try:
        return FOLDS[name](*arguments)
    except (OverflowError, ZeroDivisionError):
        return math.inf
    except ValueError:  # the logarithm of zero
        return -math.inf


def lowered(function, argument):
    """Program, leaves and outputs of a function of one tensor."""
    from torch.fx.experimental.proxy_tensor import make_fx

    graph = make_fx(lambda a: (function(a),), decompositions())(argument)
    program = Program()
    entries = Lowering(program, HANDLERS).constants(argument)
    for index, _ in enumerate(entries.flat):
        entries.flat[index] = program.leaf("p", index)
    (result,) = Lowering(program, HANDLERS)(graph, [entries])
    return program, list(entries.flat), result


@pytest.mark.parametrize("name", FUNCTIONS)
def test_an_operation_and_its_derivative_are_those_of_torch(name):
    argument = torch.tensor(VALUES, dtype=torch.float64, requires_grad=True)
    expected = FUNCTIONS[name](argument)
    weights = torch.linspace(0.5, 1.5, expected.numel(), dtype=torch.float64)
    (slopes,) = torch.autograd.grad((expected.flatten() * weights).sum(), argument)
    program, leaves, result = lowered(FUNCTIONS[name], argument.detach())
    assert result.shape == expected.shape
    given = {("p", i): value for i, value in enumerate(argument.flatten().tolist())}
    weighted: dict = {}
    for node, weight in zip(result.flat, weights.tolist(), strict=True):
        before = weighted.get(node, program.constant(0.0))
        weighted[node] = program.apply("add", before, program.constant(weight))
    values = torch.tensor(run(program, list(result.flat), given), dtype=torch.float64)
    torch.testing.assert_close(values, expected.detach().flatten())
    found = torch.tensor(run(program, gradient(program, weighted, leaves), given)).to(slopes)
    torch.testing.assert_close(found, slopes.flatten())


@pytest.mark.parametrize("function", [torch.sigmoid, torch.tanh, torch.nn.functional.softplus])
def test_what_saturates_has_a_slope_at_any_number(function):
    numbers = torch.tensor([-1e4, -800.0, -30.0, 0.0, 30.0, 800.0, 1e4], dtype=torch.float64)
    numbers.requires_grad_()
    (slopes,) = torch.autograd.grad(function(numbers).sum(), numbers, create_graph=True)
    (bends,) = torch.autograd.grad(slopes.sum(), numbers)
    program, leaves, result = lowered(function, numbers.detach())
    first = gradient(program, dict.fromkeys(result.flat, program.constant(1.0)), leaves)
    second = gradient(program, dict.fromkeys(first, program.constant(1.0)), leaves)
    given = {("p", i): value for i, value in enumerate(numbers.tolist())}
    found = torch.tensor(run(program, [*first, *second], given), dtype=torch.float64)
    torch.testing.assert_close(found, torch.cat([slopes, bends]).detach(), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    "function",
    [
        lambda a: torch.nn.functional.huber_loss(a, 0 * a, reduction="none", delta=0.5),
        lambda a: torch.nn.functional.smooth_l1_loss(a, 0 * a, reduction="none", beta=0.5),
        torch.nn.functional.logsigmoid,
    ],
)
def test_what_is_smooth_at_zero_bends_there(function):
    """The core forms of torch are written with |a|, whose square has no curvature at zero."""
    numbers = torch.tensor([-800.0, -0.3, 0.0, 0.3, 800.0], dtype=torch.float64)
    numbers.requires_grad_()
    (slopes,) = torch.autograd.grad(function(numbers).sum(), numbers, create_graph=True)
    (bends,) = torch.autograd.grad(slopes.sum(), numbers)
    assert bends[2] != 0
    program, leaves, result = lowered(function, numbers.detach())
    first = gradient(program, dict.fromkeys(result.flat, program.constant(1.0)), leaves)
    second = gradient(program, dict.fromkeys(first, program.constant(1.0)), leaves)
    given = {("p", i): value for i, value in enumerate(numbers.tolist())}
    found = torch.tensor(run(program, [*first, *second], given), dtype=torch.float64)
    torch.testing.assert_close(found, torch.cat([slopes, bends]).detach())


def test_a_choice_hides_the_infinite_slope_of_what_is_not_taken():
    program, leaves, result = lowered(
        lambda a: torch.where(a > 0, a.sqrt(), torch.zeros_like(a)), torch.zeros(1)
    )
    slopes = gradient(program, {result[0]: program.constant(1.0)}, leaves)
    assert run(program, slopes, {("p", 0): 0.0}) == [0.0]


@pytest.mark.parametrize(
    ("function", "told"),
    [
        (lambda a: a.sort().values, "sort"),
        (lambda a: a.index_select(-1, a[0, :1].long()), "not constant"),
        (lambda a: torch.div(a, 2.0, rounding_mode="trunc"), "rounding_mode=trunc"),
        (lambda a: torch.linalg.vector_norm(a, 3), "norm of order 3"),
    ],
)
def test_what_has_no_scalar_form_is_named(function, told):
    with pytest.raises(CannotLowerError, match=told):
        lowered(function, torch.tensor(VALUES))


def test_every_operation_has_a_derivative():
    assert set(RULES) == set(FOLDS)


@pytest.mark.parametrize(
    ("name", "numbers", "folded"),
    [
        ("pow", (-8.0, 1 / 3), None),  # no number: left to the compiler
        ("pow", (-8.0, 3.0), -512.0),
        ("pow", (0.0, -1.0), None),
        ("div", (1.0, 0.0), math.inf),
        ("div", (1.0, -0.0), -math.inf),
        ("div", (-1.0, -0.0), math.inf),
    ],
)
def test_constants_are_folded_to_the_number_of_torch(name, numbers, folded):
    program = Program()
    node = program.apply(name, *map(program.constant, numbers))
    assert program.value(node) == folded
    if folded is not None:
        function = {"pow": torch.pow, "div": torch.div}[name]
        assert function(*(torch.tensor(each) for each in numbers)).item() == folded


def test_equal_operations_are_one_and_zeros_are_gone():
    program = Program()
    a, b, zero, one = (
        program.leaf("p", 0),
        program.leaf("p", 1),
        program.constant(0.0),
        program.constant(1.0),
    )
    product = program.apply("mul", a, b)
    assert program.apply("mul", b, a) == product
    assert (
        program.apply("add", program.apply("mul", product, zero), program.apply("mul", b, one)) == b
    )
    assert program.apply("neg", program.apply("neg", a)) == a
    assert program.value(program.apply("div", one, zero)) == float("inf")
    assert program.constant(0.0) != program.constant(-0.0) != program.constant(False)
