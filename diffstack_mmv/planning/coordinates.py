"""Coordinates in which an optimiser sees the controls of a plan."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.control.native.scan import scan
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.types import Bounds

SHORT = 4e-6
"""Share of the way to a kink that is left out: rounding must not go beyond it."""


@runtime_checkable
class ControlCoordinates(Protocol):
    """Coordinates of the controls of a model, with a box of their own."""

    @property
    def bounds(self) -> Bounds:
        """Box of the coordinates."""
        ...

    @property
    def step(self) -> Callable[[Tensor, Tensor], Tensor]:
        """One step of the model: (state, coordinates) -> next state."""
        ...

    def controls(
        self, states: Float[Tensor, "*b n"], coordinates: Float[Tensor, "*b m"]
    ) -> Float[Tensor, "*b m"]:
        """Controls `*b m` in SI units at some states `*b n`."""
        ...

    def padded_controls(
        self, states: Float[Tensor, "*b T1 n"], coordinates: Float[Tensor, "*b T1 m"]
    ) -> Float[Tensor, "*b T1 m"]:
        """Controls `*b T1 m` along a plan, with a last row of zeros."""
        ...

    def coordinates(
        self, start: Float[Tensor, "b n"], controls: Float[Tensor, "b T m"], compile: bool = False
    ) -> Float[Tensor, "b T m"]:
        """Coordinates of the controls of plans from some states, without a gradient.

        Args:
            start: The states.
            controls: The controls.
            compile: Find them in a generated library where there is one.
        """
        ...


Coordinates = Callable[[DynamicsModel], ControlCoordinates]


class PhysicalControls:
    """The controls themselves.

    Args:
        dynamics: The model.
    """

    def __init__(self, dynamics: DynamicsModel) -> None:
        self.dynamics = dynamics

    @property
    def bounds(self) -> Bounds:
        """Box of the controls."""
        return self.dynamics.bounds

    @property
    def step(self) -> Callable[[Tensor, Tensor], Tensor]:
        """The model."""
        return self.dynamics

    def controls(
        self, states: Float[Tensor, "*b n"], coordinates: Float[Tensor, "*b m"]
    ) -> Float[Tensor, "*b m"]:
        """What was given."""
        return coordinates

    def padded_controls(
        self, states: Float[Tensor, "*b T1 n"], coordinates: Float[Tensor, "*b T1 m"]
    ) -> Float[Tensor, "*b T1 m"]:
        """What was given."""
        return coordinates

    def coordinates(
        self, start: Float[Tensor, "b n"], controls: Float[Tensor, "b T m"], compile: bool = False
    ) -> Float[Tensor, "b T m"]:
        """What was given."""
        return controls


class AccelerationShares:
    """The acceleration as its share s of the way from the least to the most that is of use.

        a = a₀(v) + s (a₁(v) - a₀(v)),  0 ≤ s ≤ 1,
        a₀(v) = max(a_min, (v_low - v) / dt),  a₁(v) = min(a_max, (v_top - v) / dt)

    A model that is kept from backing up by a floor has a kink where it comes to rest, v_low = 0,
    and one that is governed to a top speed another there. A plan that brakes to rest, or drives at
    its top speed, ends on it: no derivative tells which way the cost falls. Braking harder than to
    rest only costs effort, so nothing is lost by leaving it out; speeding up harder than to the top
    gains the part of a step. In these coordinates the kinks are the bounds s = 0 and s = 1, which
    the optimiser holds like any other, and whose pressure has a derivative.

    Args:
        dynamics: A model with a `useful_acceleration`, and an acceleration among its controls.
    """

    def __init__(self, dynamics: DynamicsModel) -> None:
        self.dynamics = dynamics
        self.column = dynamics.Control._fields.index("acceleration")

    @property
    def bounds(self) -> Bounds:
        """Box of the controls, with the shares in place of the acceleration."""
        lower, upper = (bound.clone() for bound in self.dynamics.bounds)
        lower[self.column], upper[self.column] = 0.0, 1.0
        return Bounds(lower, upper)

    def step(
        self, state: Float[Tensor, "*b n"], coordinates: Float[Tensor, "*b m"]
    ) -> Float[Tensor, "*b n"]:
        """One step of the model, given shares."""
        return self.dynamics(state, self.controls(state, coordinates))

    def controls(
        self, states: Float[Tensor, "*b n"], coordinates: Float[Tensor, "*b m"]
    ) -> Float[Tensor, "*b m"]:
        """Controls `*b m` in SI units at some states `*b n`."""
        columns = list(coordinates.unbind(-1))
        least, most = self._range(states)
        columns[self.column] = torch.lerp(least, most, columns[self.column])
        return torch.stack(columns, -1)

    def padded_controls(
        self, states: Float[Tensor, "*b T1 n"], coordinates: Float[Tensor, "*b T1 m"]
    ) -> Float[Tensor, "*b T1 m"]:
        """Controls `*b T1 m` along a plan, with a last row of zeros."""
        steps = torch.arange(states.shape[-2], device=states.device)
        acting = (steps < states.shape[-2] - 1).to(states.dtype)
        return self.controls(states, coordinates) * acting.unsqueeze(-1)

    @torch.no_grad()
    def coordinates(
        self, start: Float[Tensor, "b n"], controls: Float[Tensor, "b T m"], compile: bool = False
    ) -> Float[Tensor, "b T m"]:
        """Shares `b T m` along the motions; what is beyond an end is the end."""
        found = scan(self._told, start, controls, [self.dynamics]) if compile else None
        if found is not None:
            return found.outputs
        state, rows = start, []
        for control in controls.unbind(-2):
            state, shares = self._told(state, control)
            rows.append(shares)
        return torch.stack(rows, -2)

    def _told(
        self, state: Float[Tensor, "*b n"], control: Float[Tensor, "*b m"]
    ) -> tuple[Float[Tensor, "*b n"], Float[Tensor, "*b m"]]:
        """The next state, and the coordinates of a control."""
        columns = list(control.unbind(-1))
        least, most = self._range(state)
        way = (most - least).clamp_min(torch.finfo(most.dtype).tiny)
        columns[self.column] = ((columns[self.column] - least) / way).clamp(0, 1)
        shares = torch.stack(columns, -1)
        return self.step(state, shares), shares

    def _range(
        self, states: Float[Tensor, "*b n"]
    ) -> tuple[Float[Tensor, "*b"], Float[Tensor, "*b"]]:
        """Acceleration (m/s²) of the shares zero and one."""
        lower, upper = (bound[self.column] for bound in self.dynamics.bounds)
        useful = self.dynamics.useful_acceleration(states)
        if useful is None:
            return lower.expand_as(states[..., 0]), upper.expand_as(states[..., 0])
        # whoever is faster than the top speed brakes to it as hard as the box allows
        least, most = ((1 - SHORT) * end for end in useful)
        least, most = (torch.minimum(torch.maximum(end, lower), upper) for end in (least, most))
        return least, most


def above_rest(dynamics: DynamicsModel) -> ControlCoordinates:
    """Shares for a model with a kink at rest or at its top speed, its controls for any other."""
    state = torch.zeros(dynamics.state_dim, device=dynamics.bounds.lower.device)
    kinked = dynamics.useful_acceleration(state) is not None
    return AccelerationShares(dynamics) if kinked else PhysicalControls(dynamics)
