"""Problems of a batch as rows of numbers: the first one is taken down, and holds for all."""

from collections.abc import Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control.compilation import copied, refusals
from diffstack_mmv.control.native.capture import Recorder, Taken, Trajectory, evaluate
from diffstack_mmv.control.native.lowering import CannotLowerError
from diffstack_mmv.control.optimizer import Cost, Dynamics
from diffstack_mmv.control.selection import Batched

MOST_RENEWALS = 2
"""Times that a kind of problem may outgrow the compiler's list of graphs, 8 shapes each time."""


class TakenBatch(NamedTuple):
    """The first problem of a batch, and the parameters of all."""

    taken: Taken
    parameters: list[Tensor]  # of each problem (count, ...), or shared


class BatchRecorder:
    """Takes down the problems of one kind."""

    def __init__(self) -> None:
        self.renewals = 0
        self.record = Recorder(copied(evaluate))

    def __call__(
        self, dynamics: Dynamics, cost: Cost, at: Trajectory, dtype: torch.dtype
    ) -> TakenBatch:
        """The stages of the problems, and their parameters.

        Args:
            dynamics: Of the batch.
            cost: Of the batch.
            at: Where one problem is taken down.
            dtype: Of states and parameters.

        Raises:
            CannotLowerError: They have no scalar form, or too many shapes were seen.
        """
        originals: dict[int, Tensor] = {}
        first = _first(dynamics, originals), _first(cost, originals)
        try:
            taken = self.record(at, *first)
        except refusals().too_many_graphs as failure:
            self.renewals += 1
            if self.renewals > MOST_RENEWALS:
                raise CannotLowerError("too many shapes") from failure
            self.record = Recorder(copied(evaluate))
            taken = self.record(at, *first)
        for one in taken.parameters:
            if one.is_floating_point() and one.dtype != dtype and one.dim() > 0:
                raise CannotLowerError(f"a parameter of {one.dtype} beside a state of {dtype}")
        return TakenBatch(taken, [originals.get(id(one), one) for one in taken.parameters])


def _first(function: Any, originals: dict[int, Tensor]) -> Any:
    """A callable for the first problem of a batch; tells where its tensors come from."""
    if not isinstance(function, Batched):
        return function
    # copied: else a stride of the one row tells what it was cut from, which is one more shape
    laid_out = {"memory_format": torch.contiguous_format}
    slices = [each.detach()[:1].clone(**laid_out) for each in function.tensors]
    originals.update(zip(map(id, slices), function.tensors, strict=True))
    return Batched(function.function, *slices)


def in_rows(
    problem: Taken, tensors: Sequence[Tensor], count: int, like: Tensor
) -> Float[Tensor, "count P"]:
    """Parameters as one row per problem, of the type and on the device of another tensor."""
    plain = [each.detach().to(like) for each in tensors]
    if count == 1:
        return torch.cat([each.reshape(-1) for each in plain] or [like.new_empty(0)]).unsqueeze(0)
    rows = [like.new_empty(count, 0)]
    for one, each, whole in zip(problem.parameters, plain, tensors, strict=True):
        # by its size: an empty one has no length that could be found
        flat = each.reshape(len(each) if whole is not one else 1, one.numel())
        rows.append(flat.expand(count, -1))
    return torch.cat(rows, 1)


class Form(NamedTuple):
    """What a slope of a tensor looks like; without it nobody has to keep the tensor."""

    shape: torch.Size
    dtype: torch.dtype
    device: torch.device
    first: int  # place of its first number in a row
    size: int  # numbers of it in a row


def forms_of(
    tensors: Sequence[Tensor], sizes: Sequence[int], wanted: Sequence[bool]
) -> list[Form | None]:
    """Forms of the tensors whose slopes are wanted."""
    places = accumulate(sizes, initial=0)
    return [
        Form(each.shape, each.dtype, each.device, first, size) if is_wanted else None
        for each, first, size, is_wanted in zip(tensors, places, sizes, wanted, strict=False)
    ]


def from_rows(rows: Float[Tensor, "count P"], forms: Sequence[Form | None]) -> list[Tensor | None]:
    """Slopes of the parameters that have a form; of a shared one the sum over the problems."""
    wanted = [form for form in forms if form is not None]
    is_shared = any(form.shape.numel() != len(rows) * form.size for form in wanted)
    total = rows.sum(0, keepdim=True) if is_shared else rows
    slopes: list[Tensor | None] = []
    for form in forms:
        if form is None:
            slopes.append(None)
            continue
        source = rows if form.shape.numel() == len(rows) * form.size else total
        slope = source[:, form.first : form.first + form.size].reshape(form.shape)
        slopes.append(slope.to(form.device, form.dtype))
    return slopes
