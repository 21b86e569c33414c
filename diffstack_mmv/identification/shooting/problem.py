"""The tracking problem: which controls, and which start, explain a recorded track.

It is the same for every model, so that models can be compared by it. The rider's command is an
acceleration a and a path curvature κ, both piecewise constant; a model turns them into controls of
its own (`DynamicsModel.control_for`). Per track the unknowns are the initial condition d
(position, course, speed, a, κ at the start, relative to a guess) and the rates c_t of (a, κ):

    min ½ Σ_t |R(p_t - y_t) / σ_pos|² + ½ |c_t|² + ½ |d|² [+ ½ Σ_t ((δ_t - δ_{t-1}) / (σ_δ dt))²]
                                                          [+ ½ Σ_t |(u_t - u_measured) / σ_u|²]

with errors along and across the track. Because the rates are those of the path and not of the
steering angle, the regularisation says nothing about the physical parameters: a longer wheelbase
costs nothing. A prior on the steering rate (σ_δ), which does inform the wheelbase, is optional, as
are recorded controls u with their noise σ_u.
"""

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

INITIAL_DIM = 6  # unknowns of the start: x, y, course, speed, acceleration, curvature
COMMAND_DIM = 2  # acceleration, curvature


class Measurements(NamedTuple):
    """What the states are compared with at each time."""

    position: Float[Tensor, "N T1 2"]  # m
    course: Float[Tensor, "N T1"]  # rad
    weight: Float[Tensor, "N T1"]  # 1 where recorded, 0 in the padding
    controls: Float[Tensor, "N T1 m"]  # measured
    control_weight: Float[Tensor, "N T1 m"]  # 1 / σ_u where measured, else 0


class Unknowns(NamedTuple):
    """What is inferred of each track, in units of the standard deviations."""

    initial: Float[Tensor, "N 6"]  # d
    rates: Float[Tensor, "N T 2"]  # c
    nodes: Float[Tensor, "N m s"]  # states where shooting intervals begin, in physical units


class TrackingProblem(NamedTuple):
    """Tracks with an initial guess of the unknowns."""

    measurements: Measurements
    start: Float[Tensor, "N 6"]  # x, y (m), course (rad), speed (m/s), a (m/s²), κ (1/m)
    guess: Unknowns
