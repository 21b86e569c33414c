"""The shapes and types in the annotations of the package are checked while the tests run."""

import ast
from pathlib import Path

import pytest
import torch
from beartype import beartype
from beartype.roar import BeartypeCallHintViolation
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics import DiffKBM
from diffstack_mmv.geometry import rotate
from diffstack_mmv.simulation.pedestrians.base import towards
from diffstack_mmv.vehicles import WheelSpec, load_vehicle
from dmmv_conventions.checks import require_positive
from tests import shape_checks
from tests.shape_checks import begin_test, checked


@pytest.mark.parametrize(
    ("vector", "angle"),
    [
        (torch.zeros(4, 3), torch.zeros(4)),
        (torch.zeros(4, 2), torch.zeros(5)),
        (torch.zeros(4, 2, dtype=torch.int64), torch.zeros(4)),
    ],
    ids=["columns", "batch", "type"],
)
def test_a_wrong_tensor_is_refused(vector, angle):
    with pytest.raises(BeartypeCallHintViolation, match="rotate"):
        rotate(vector, angle)


MODEL = DiffKBM(load_vehicle("bicycle"))


@pytest.mark.parametrize(
    ("callable_", "arguments", "named"),
    [
        (require_positive, ("step", "one"), "value"),
        (towards, (torch.zeros(4, 2), torch.zeros(5, 2)), "goal"),
        (MODEL.control_for, (torch.zeros(3, 4), torch.zeros(2), torch.zeros(3)), "control_for"),
        (WheelSpec, ("front", "0.5", 0.0, 0.3), "x_m"),
    ],
    ids=["a type", "an axis of two arguments", "a method", "a dataclass"],
)
def test_what_does_not_fit_is_refused_wherever_it_is_given(callable_, arguments, named):
    with pytest.raises(BeartypeCallHintViolation, match=named):
        callable_(*arguments)


def test_a_whole_number_may_stand_for_a_float():
    require_positive("step", 1)


@pytest.mark.usefixtures("unchecked")
def test_a_test_can_let_wrong_shapes_through():
    assert rotate(torch.zeros(4, 3), torch.zeros(4)).shape == (4, 2)


def test_a_result_of_another_shape_is_refused():
    def wrong(value: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        return value[1:]

    wrong.__qualname__ = "wrong"
    assert checked(wrong, typechecker=beartype)(torch.zeros(1)[:0]).shape == (0,)
    with pytest.raises(BeartypeCallHintViolation, match="return"):
        checked(wrong, typechecker=beartype)(torch.zeros(3))


def test_the_first_calls_of_a_test_are_checked(monkeypatch):
    monkeypatch.setattr(shape_checks, "CALLS", 10)

    def halved(value: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        return 0.5 * value

    halved.__qualname__ = "halved"
    function, wrong = checked(halved, typechecker=beartype), torch.zeros(3, 2)
    for _ in range(9):
        function(torch.zeros(3))
    with pytest.raises(BeartypeCallHintViolation):
        function(wrong)
    assert function(wrong).shape == (3, 2)
    begin_test()
    with pytest.raises(BeartypeCallHintViolation):
        function(wrong)


@pytest.mark.slow
@pytest.mark.usefixtures("nothing_compiled")
def test_a_compiled_function_is_not_checked():
    whole = torch.compile(rotate, fullgraph=True, backend="eager")
    vector, angle = torch.rand(4, 2), torch.rand(4)
    assert torch.allclose(whole(vector, angle), rotate(vector, angle))


def attributes_of_protocols():
    """Class, name and names in the type of every attribute that a protocol asks for."""
    for path in sorted((Path(__file__).parents[1] / "diffstack_mmv").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and "Protocol" in map(ast.unparse, node.bases):
                for line in node.body:
                    if isinstance(line, ast.AnnAssign):
                        names = [n.id for n in ast.walk(line.annotation) if isinstance(n, ast.Name)]
                        yield node.name, ast.unparse(line.target), names


def test_protocols_ask_for_plain_attributes_only():
    """Python 3.12 does not find what a module keeps apart: parameters, buffers and parts."""
    found = list(attributes_of_protocols())
    assert ("GoalSource", "name", ["str"]) in found
    plain = {"bool", "int", "float", "str", "list", "dict", "tuple"}
    assert [each for each in found if not plain.issuperset(each[2])] == []
