"""The shapes and types in the annotations of the package are checked while the tests run."""

import pytest
import torch
from jaxtyping import TypeCheckError

from diffstack_mmv.checks import require_positive
from diffstack_mmv.dynamics import DiffKBM
from diffstack_mmv.geometry import rotate
from diffstack_mmv.vehicles import load_vehicle


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
    with pytest.raises(TypeCheckError, match="rotate"):
        rotate(vector, angle)


def test_a_wrong_tensor_is_refused_by_a_method():
    model = DiffKBM(load_vehicle("bicycle"))
    with pytest.raises(TypeCheckError, match="control_for"):
        model.control_for(torch.zeros(3, 4), torch.zeros(2), torch.zeros(3))


def test_a_wrong_type_is_refused():
    with pytest.raises(TypeCheckError, match="value"):
        require_positive("step", "one")
