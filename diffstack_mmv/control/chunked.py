"""Local models of dynamics that all problems share, a fixed number of pairs at a time.

Dynamics that hide no tensor of the batch see every pair (x_t, u_t) alone: times, problems,
cotangents and shifts can be laid out as one row of columns, and cut into chunks of one size. A
large model is then compiled once, for one shape, whatever the batch and the horizon.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.control.expansion import HessianBlocks, Model, Value
from diffstack_mmv.control.optimizer import Cost, Dynamics

PAIRS = 2048


class Chunked(NamedTuple):
    """What a local model is made of, eager or compiled."""

    pull: Callable[..., Tensor]
    value_along: Callable[..., Value]
    assemble: Callable[..., Model]

    def __call__(
        self,
        dynamics: Dynamics,
        cost: Cost,
        like: Float[Tensor, "*b"],
        x: Float[Tensor, "T1 n N"],
        u: Float[Tensor, "T m N"],
        near: Bool[Tensor, " N"],
    ) -> Model:
        """As `expand_by_differences`, for dynamics that all problems share."""
        n = x.shape[1]
        points = torch.concatenate([x[:-1], u], 1).movedim(1, 0)
        eye = torch.eye(n, dtype=x.dtype, device=x.device)
        jacobian = self._pull_all(dynamics, points.unsqueeze(1), eye[..., None, None])
        by_time = jacobian.permute(2, 1, 0, 3)
        A, B = by_time[:, :, :n].contiguous(), by_time[:, :, n:].contiguous()
        value = self.value_along(cost, like, x, u, A)
        index = near.nonzero().squeeze(-1)
        parts = points, value.costates.movedim(1, 0), jacobian
        some = self._curvature(dynamics, *(part.index_select(-1, index) for part in parts))
        bend = some.new_zeros(*some.shape[:-1], len(near)).index_copy_(-1, index, some)
        blocks = bend[:, :n, :n], bend[:, n:, :n], bend[:, n:, n:]
        return self.assemble(
            x, u, A, B, value, HessianBlocks(*(part.contiguous() for part in blocks))
        )

    def _curvature(
        self,
        dynamics: Dynamics,
        points: Float[Tensor, "k T N"],
        costates: Float[Tensor, "n T N"],
        jacobian: Float[Tensor, "k n T N"],
    ) -> Float[Tensor, "T k k N"]:
        """Hessian of λ · f; entries that are only carried on, as a position is, are not shifted."""
        k, n = jacobian.shape[:2]
        step = torch.finfo(points.dtype).eps ** 0.5
        eye = torch.eye(k, dtype=points.dtype, device=points.device)
        curved = (jacobian != eye[:, :n, None, None]).flatten(1).any(1)
        entries = curved.nonzero().squeeze(-1)
        shifted = points.unsqueeze(1) + step * eye[:, entries, None, None]
        gradients = self._pull_all(dynamics, shifted, costates.unsqueeze(1))
        unshifted = (jacobian * costates).sum(1, keepdim=True)
        hessian = jacobian.new_zeros(k, k, *points.shape[1:])
        hessian[:, entries] = (gradients - unshifted) / step
        known = curved.unsqueeze(1).to(eye) + curved  # how often each entry is there
        hessian = (hessian + hessian.transpose(0, 1)) / known.clamp_min(1)[..., None, None]
        return hessian.movedim(2, 0)

    def _pull_all(
        self,
        dynamics: Dynamics,
        points: Float[Tensor, "k r1 T N"],
        weights: Float[Tensor, "n r2 t N2"],
    ) -> Float[Tensor, "k r T N"]:
        """Gradients at all columns; the points and the weights broadcast against one another."""
        shape = torch.broadcast_shapes(points.shape[1:], weights.shape[1:])
        count, k = shape.numel(), len(points)
        columns = points.new_zeros(k + len(weights), count + -count % PAIRS)
        columns[:k, :count].view(k, *shape).copy_(points)
        columns[k:, :count].view(len(weights), *shape).copy_(weights)
        chunks = columns.unflatten(1, (-1, PAIRS)).movedim(1, 0).contiguous()
        pulled = columns.new_empty(k, *chunks.shape[::2])
        for i, chunk in enumerate(chunks):
            pulled[:, i] = self.pull(dynamics, chunk[:k], chunk[k:])
        return pulled.flatten(1)[:, :count].reshape(k, *shape)


def pull(
    dynamics: Dynamics, points: Float[Tensor, "k P"], weights: Float[Tensor, "n P"]
) -> Float[Tensor, "k P"]:
    """Gradient of w · f(x, u) at every column (x, u)."""
    n = len(weights)

    def weighted(points: Tensor) -> Tensor:
        following = dynamics(points[:n].movedim(0, -1), points[n:].movedim(0, -1))
        return (weights * following.movedim(-1, 0)).sum()

    return torch.func.grad(weighted)(points)
