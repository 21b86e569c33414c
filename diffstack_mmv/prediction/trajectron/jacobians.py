"""Jacobians of one control step: in closed form where a model has one, else by forward mode."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from diffstack_mmv.dynamics import DiffKBM, DynamicsModel, ExtendedUnicycle, SingleIntegrator
from diffstack_mmv.geometry import direction, left_of
from diffstack_mmv.smooth import saturate, sinc, sinc_slope

POSE = ("position_x", "position_y", "heading")


class Linearisation(NamedTuple):
    """Jacobians of one control step at points `*b`."""

    state: Float[Tensor, "*b n n"]
    control: Float[Tensor, "*b n m"]


def linearise(
    dynamics: DynamicsModel, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
) -> Linearisation:
    """Jacobians A = ∂f/∂x and B = ∂f/∂u at all points in one call."""
    closed_form = _CLOSED_FORMS.get(type(dynamics))
    if closed_form is not None:
        return closed_form(dynamics, state, control)
    if dynamics.moves_with_pose:
        return _linearise_turned(dynamics, state, control)
    return linearise_forward(dynamics, state, control)


def has_closed_form(dynamics: DynamicsModel) -> bool:
    """Whether `linearise` costs about as much as a step."""
    return type(dynamics) in _CLOSED_FORMS


def linearise_shared(
    dynamics: DynamicsModel,
    state: Float[Tensor, "R K T n"],
    control: Float[Tensor, "R K T m"],
) -> Linearisation:
    """Jacobians at the mean over the K components, turned to the heading of each component.

    A model that does not care where it stands and where it points has, with the frame S = (rotation
    of the position by θ, else identity), A(θ) = S A(0) Sᵀ and B(θ) = S B(0). What is neglected is
    how speed and control differ between the components; what is gained is a factor K.
    """
    fields = dynamics.State._fields
    columns = zip(fields, state.unbind(-1), strict=True)
    rest = [torch.zeros_like(value) if name in POSE else value for name, value in columns]
    centre = torch.stack(rest, -1).mean(1)
    shared = linearise(dynamics, centre, control.mean(1))
    if "heading" not in fields:
        return Linearisation(
            shared.state.unsqueeze(1).expand(*state.shape, -1),
            shared.control.unsqueeze(1).expand(*state.shape, -1),
        )
    frame = _frames(state[..., fields.index("heading")], state.shape[-1])
    turned = frame @ shared.state.unsqueeze(1)
    return Linearisation(turned @ frame.mT, frame @ shared.control.unsqueeze(1))


def _frames(heading: Float[Tensor, "*b"], size: int) -> Float[Tensor, "*b n n"]:
    """Rotate the first two of so many columns by a heading in rad, and keep the others."""
    forward = direction(heading)
    left = left_of(forward)
    rotation = nn.functional.pad(torch.stack([forward, left], -1), (0, size - 2, 0, size - 2))
    rest = torch.ones(size, dtype=heading.dtype, device=heading.device)
    rest[:2] = 0
    return rotation + torch.diag(rest)


def linearise_forward(
    dynamics: DynamicsModel, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
) -> Linearisation:
    """`linearise` for any model, by forward mode."""
    n = state.shape[-1]
    columns = jacobian(
        lambda point: dynamics(point[..., :n], point[..., n:]), torch.cat([state, control], -1)
    )
    return Linearisation(columns[..., :n], columns[..., n:])


def jacobian(
    function: Callable[[Tensor], Tensor], point: Float[Tensor, "*b p"]
) -> Float[Tensor, "*b o p"]:
    """Derivatives of a function of single points, one tangent per column."""

    def push(tangent: Float[Tensor, " p"]) -> Tensor:
        return torch.func.jvp(function, (point,), (tangent.expand_as(point),))[1]

    tangents = torch.eye(point.shape[-1], dtype=point.dtype, device=point.device)
    return torch.func.vmap(push, out_dims=-1)(tangents)


def _linearise_turned(
    dynamics: DynamicsModel, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
) -> Linearisation:
    """`linearise` by forward mode, without tangents for the pose."""
    shape, n = state.shape[:-1], state.shape[-1]
    columns = (part.reshape(-1, part.shape[-1]).mT for part in (state, control))
    whole = linearised_columns(dynamics, *columns)[1].permute(2, 1, 0)
    whole = whole.reshape(*shape, *whole.shape[1:])
    return Linearisation(whole[..., :n], whole[..., n:])


def linearised_columns(
    dynamics: DynamicsModel, state: Float[Tensor, "n N"], control: Float[Tensor, "m N"]
) -> tuple[Float[Tensor, "n N"], Float[Tensor, "k n N"]]:
    """Step and Jacobian of a model that moves with its pose: entry (j, i) is ∂f_i / ∂(x, u)_j."""
    n = len(state)

    def step(point: Tensor) -> Tensor:
        following: Tensor = dynamics(point[:n].mT, point[n:].mT)
        return following.mT

    point = torch.cat([state, control])

    def push(tangent: Float[Tensor, " k"]) -> tuple[Tensor, Tensor]:
        along = tangent.unsqueeze(-1) + torch.zeros_like(point)
        pushed = torch.func.jvp(step, (point,), (along,))
        return pushed[0], pushed[1]

    fields = dynamics.State._fields
    moving = [column for column in range(len(point)) if column >= n or fields[column] not in POSE]
    seeds = torch.eye(len(point), dtype=point.dtype, device=point.device)[moving]
    following, pushed = torch.func.vmap(push, out_dims=(None, 0))(seeds)  # pyright: ignore[reportArgumentType]
    rows, pose = iter(pushed.unbind(0)), _by_pose(fields, state, following)
    columns = [pose[j] if j in pose else next(rows) for j in range(len(point))]
    return following.contiguous(), torch.stack(columns)


def _by_pose(
    fields: Sequence[str], state: Float[Tensor, "n N"], following: Float[Tensor, "n N"]
) -> dict[int, Float[Tensor, "n N"]]:
    """Derivatives in the pose: the next pose is moved and turned with the present one."""
    x, y, heading = (fields.index(name) for name in POSE)
    zero, one = torch.zeros_like(state[0]), torch.ones_like(state[0])
    turned = [zero] * len(fields)
    turned[x], turned[y], turned[heading] = state[y] - following[y], following[x] - state[x], one
    found = {heading: torch.stack(turned)}
    for column in (x, y):
        found[column] = torch.stack([one if row == column else zero for row in range(len(fields))])
    return found


def _bicycle(dynamics: DiffKBM, state: Tensor, control: Tensor) -> Linearisation:
    """`DiffKBM`: the rows are position, heading and speed."""
    dt_s, (speed_up, turn) = dynamics.dt_s, _slopes(dynamics, control)
    acceleration, steer = saturate(control, *dynamics.bounds).unbind(-1)
    cosine, sine, speed = state[..., 2].cos(), state[..., 2].sin(), state[..., 3]
    next_speed, kept = _value_and_slope(dynamics.floor, speed + dt_s * acceleration)
    tangent = steer.tan()
    curvature = tangent / dynamics.wheelbase()
    way, by_acceleration = dt_s * speed, dt_s * kept * speed_up
    by_steer = dt_s / dynamics.wheelbase() * next_speed * (1 + tangent.square()) * turn
    one, zero = torch.ones_like(speed), torch.zeros_like(speed)
    return Linearisation(
        _matrix(
            [
                [one, zero, -way * sine, dt_s * cosine],
                [zero, one, way * cosine, dt_s * sine],
                [zero, zero, one, dt_s * curvature * kept],
                [zero, zero, zero, kept],
            ]
        ),
        _matrix(
            [
                [zero, zero],
                [zero, zero],
                [dt_s * curvature * by_acceleration, by_steer],
                [by_acceleration, zero],
            ]
        ),
    )


def _unicycle(dynamics: ExtendedUnicycle, state: Tensor, control: Tensor) -> Linearisation:
    """`ExtendedUnicycle`: a chord of the circle, turned by half of the turn of the step."""
    dt_s, (turn, speed_up) = dynamics.dt_s, _slopes(dynamics, control)
    yaw_rate, acceleration = saturate(control, *dynamics.bounds).unbind(-1)
    half = 0.5 * dt_s * yaw_rate
    forward, (sideways, bend) = sinc(half), _value_and_slope(sinc_slope, half)
    course, way = state[..., 2] + half, dt_s * (state[..., 3] + 0.5 * dt_s * acceleration)
    cosine, sine = course.cos(), course.sin()
    across = 0.5 * dt_s**2 * acceleration

    def turned(along: Tensor, aside: Tensor) -> tuple[Tensor, Tensor]:
        return cosine * along - sine * aside, sine * along + cosine * aside

    x, y = turned(way * forward, across * sideways)
    bend_x, bend_y = turned(-way * sideways, across * bend)
    push_x, push_y = turned(0.5 * dt_s**2 * forward, 0.5 * dt_s**2 * sideways)
    one, zero = torch.ones_like(half), torch.zeros_like(half)
    by_turn, by_push = 0.5 * dt_s * turn, speed_up
    return Linearisation(
        _matrix(
            [
                [one, zero, -y, dt_s * forward * cosine],
                [zero, one, x, dt_s * forward * sine],
                [zero, zero, one, zero],
                [zero, zero, zero, one],
            ]
        ),
        _matrix(
            [
                [by_turn * (bend_x - y), by_push * push_x],
                [by_turn * (bend_y + x), by_push * push_y],
                [dt_s * turn, zero],
                [zero, dt_s * speed_up],
            ]
        ),
    )


def _integrator(dynamics: SingleIntegrator, state: Tensor, control: Tensor) -> Linearisation:
    """`SingleIntegrator`: linear but for the limits of its controls."""
    dt_s, (first, second) = dynamics.dt_s, _slopes(dynamics, control)
    one, zero = torch.ones_like(state[..., 0]), torch.zeros_like(state[..., 0])
    step, half = dt_s * one, 0.5 * dt_s**2
    return Linearisation(
        _matrix(
            [
                [one, zero, step, zero],
                [zero, one, zero, step],
                [zero, zero, one, zero],
                [zero, zero, zero, one],
            ]
        ),
        _matrix(
            [
                [half * first, zero],
                [zero, half * second],
                [dt_s * first, zero],
                [zero, dt_s * second],
            ]
        ),
    )


def _slopes(dynamics: DynamicsModel, control: Tensor) -> tuple[Tensor, ...]:
    """Derivative of each saturated control in the control."""
    return _value_and_slope(lambda value: saturate(value, *dynamics.bounds), control)[1].unbind(-1)


def _value_and_slope(
    function: Callable[[Tensor], Tensor], value: Float[Tensor, "*b"]
) -> tuple[Float[Tensor, "*b"], Float[Tensor, "*b"]]:
    """Value and derivative of a function of single numbers."""
    value = value.clone()  # an expanded tensor cannot have a tangent
    found = torch.func.jvp(function, (value,), (torch.ones_like(value),))
    return found[0], found[1]


def _matrix(rows: Sequence[Sequence[Float[Tensor, "*b"]]]) -> Float[Tensor, "*b r c"]:
    """Matrices of entries; in memory all points have one entry side by side, time outermost."""
    entries = [entry for row in rows for entry in row]
    moved = torch.stack([entry.movedim(-1, 0) if entry.dim() else entry for entry in entries])
    matrix = moved.unflatten(0, (len(rows), len(rows[0])))
    matrix = matrix.movedim(2, -1) if entries[0].dim() else matrix
    return matrix.movedim((0, 1), (-2, -1))


_CLOSED_FORMS: dict[type[DynamicsModel], Callable[[Any, Tensor, Tensor], Linearisation]] = {
    DiffKBM: _bicycle,
    ExtendedUnicycle: _unicycle,
    SingleIntegrator: _integrator,
}
"""By the class itself: one derived from it may do another step."""
