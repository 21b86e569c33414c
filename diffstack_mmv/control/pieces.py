"""Local models of dynamics that all problems share, a fixed number of pairs at a time.

Dynamics that hide no tensor of the batch see every pair (x_t, u_t) alone: times, problems,
cotangents and shifts can be laid out as one row of columns, and cut into pieces of one size. A
large model is then compiled once, for one shape, whatever the batch and the horizon.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control.expansion import Curvature, Model, Value
from diffstack_mmv.control.optimizer import Cost, Dynamics

PAIRS = 1024


class Pieces(NamedTuple):
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
    ) -> Model:
        """As `expand_by_differences`, for dynamics that all problems share."""
        points = torch.concatenate([x[:-1], u], 1).movedim(1, 0)
        A, B = self._linearise(dynamics, points, x.shape[1])
        value = self.value_along(cost, like, x, u, A)
        bend = self._curvature(dynamics, points, value.costates.movedim(1, 0))
        return self.assemble(x, u, A, B, value, bend)

    def _linearise(
        self, dynamics: Dynamics, points: Float[Tensor, "k T N"], n: int
    ) -> tuple[Float[Tensor, "T n n N"], Float[Tensor, "T n m N"]]:
        eye = torch.eye(n, dtype=points.dtype, device=points.device)
        rows = self._pull_all(dynamics, points.unsqueeze(1), eye[..., None, None])
        by_time = rows.permute(2, 1, 0, 3)
        return by_time[:, :, :n].contiguous(), by_time[:, :, n:].contiguous()

    def _curvature(
        self, dynamics: Dynamics, points: Float[Tensor, "k T N"], costates: Float[Tensor, "n T N"]
    ) -> Curvature:
        (k, *_), n = points.shape, len(costates)
        step = torch.finfo(points.dtype).eps ** 0.5
        shifts = step * torch.eye(k, k + 1, dtype=points.dtype, device=points.device)
        shifted = points.unsqueeze(1) + shifts[..., None, None]
        rows = self._pull_all(dynamics, shifted, costates.unsqueeze(1))
        hessian = ((rows[:, :-1] - rows[:, -1:]) / step).permute(2, 0, 1, 3)
        hessian = 0.5 * (hessian + hessian.transpose(1, 2))
        parts = hessian[:, :n, :n], hessian[:, n:, :n], hessian[:, n:, n:]
        return Curvature(*(part.contiguous() for part in parts))

    def _pull_all(
        self,
        dynamics: Dynamics,
        points: Float[Tensor, "k r1 T N"],
        weights: Float[Tensor, "n r2 t N2"],
    ) -> Float[Tensor, "k r T N"]:
        """Gradients at all columns; the points and the weights broadcast against one another."""
        shape = torch.broadcast_shapes(points.shape[1:], weights.shape[1:])
        columns = torch.concatenate(
            [part.expand(len(part), *shape).flatten(1) for part in (points, weights)]
        )
        count, k = columns.shape[1], len(points)
        padded = torch.nn.functional.pad(columns, (0, -count % PAIRS))
        pieces = padded.unflatten(1, (-1, PAIRS)).movedim(1, 0).contiguous()
        pulled = torch.stack([self.pull(dynamics, piece[:k], piece[k:]) for piece in pieces], 1)
        return pulled.flatten(1)[:, :count].unflatten(1, shape)


def pull(
    dynamics: Dynamics, points: Float[Tensor, "k P"], weights: Float[Tensor, "n P"]
) -> Float[Tensor, "k P"]:
    """Gradient of w · f(x, u) at every column (x, u)."""
    n = len(weights)

    def weighted(points: Tensor) -> Tensor:
        following = dynamics(points[:n].movedim(0, -1), points[n:].movedim(0, -1))
        return (weights * following.movedim(-1, 0)).sum()

    return torch.func.grad(weighted)(points)
