"""The comparison of GM3, Table IV: models against a truth that lags behind its commands.

The truth is no tyre model: acceleration and curvature follow their commands with a first-order
lag, speed drags, and friction clips the curvature. What a model scores depends on which signals it
is handed, which the paper leaves open; `VARIANTS` are the possible readings.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.base import DynamicsModel
from diffstack_mmv.dynamics.gm3.model import DiffGM3
from diffstack_mmv.dynamics.gm3.wheel_speed import DiffGM3WheelSpeed
from diffstack_mmv.dynamics.kbm import DiffKBM
from diffstack_mmv.dynamics.rollout import rollout
from diffstack_mmv.geometry import direction
from diffstack_mmv.types import GRAVITY, Motion
from diffstack_mmv.vehicles import VehicleSpec


class Signals(NamedTuple):
    """Commands and what became of them, one row per step, the position after each step."""

    command: Float[Tensor, "T 2"]  # acceleration in m/s², curvature in 1/m
    realised: Float[Tensor, "T 2"]  # the same, as realised
    speed: Float[Tensor, " T"]  # m/s, realised, at the end of the step
    intended_speed: Float[Tensor, " T"]  # m/s, by integrating the commands
    position: Float[Tensor, "T 2"]  # m


@dataclass(frozen=True)
class LaggedTruth:
    """v' = a - c v, a' = (a_cmd - a) / τ_a, κ' = (κ_cmd - κ) / τ_κ, |κ| ≤ μ g / v².

    Args:
        acceleration_lag_s: τ_a.
        curvature_lag_s: τ_κ.
        drag: c in 1/s.
        friction: μ.
    """

    acceleration_lag_s: float = 0.3
    curvature_lag_s: float = 0.25
    drag: float = 0.02
    friction: float = 0.8

    def __call__(
        self, command: Float[Tensor, "T 2"], speed_mps: float, dt_s: float, parts: int = 50
    ) -> Signals:
        """Integrate in `parts` small steps per control step."""
        fine_s = dt_s / parts
        lag = command.new_tensor([self.acceleration_lag_s, self.curvature_lag_s])
        state, position, zero = command.new_zeros(2), command.new_zeros(2), command.new_zeros(())
        heading, speed, intended = zero, zero + speed_mps, zero + speed_mps
        rows: list[list[Tensor]] = []
        for wanted in command:
            before, turned, travelled = speed, zero, zero
            for _ in range(parts):
                state = state + fine_s * (wanted - state) / lag
                grip = self.friction * GRAVITY / speed.square().clamp_min(1e-6)
                curvature = state[1].clamp(-grip, grip)
                position = position + fine_s * speed * direction(heading)
                heading = heading + fine_s * speed * curvature
                turned, travelled = turned + fine_s * speed * curvature, travelled + fine_s * speed
                speed = (speed + fine_s * (state[0] - self.drag * speed)).clamp_min(0)
            intended = (intended + dt_s * wanted[0]).clamp_min(0)
            realised = torch.stack([(speed - before) / dt_s, turned / travelled.clamp_min(1e-6)])
            rows.append([realised, speed, intended, position])
        realised, speeds, intents, positions = (
            torch.stack(list(column)) for column in zip(*rows, strict=True)
        )
        return Signals(command, realised, speeds, intents, positions)


class Variant(NamedTuple):
    """Which signals the two models are handed."""

    told: str
    gm3_by_wheel_speed: bool
    gm3_realised: bool
    kbm_realised: bool


VARIANTS = {
    "A": Variant("commands to both", False, False, False),
    "B": Variant("GM3: realised wheel speed and curvature; KBM: commands", True, True, False),
    "C": Variant("realised signals to both", True, True, True),
    "D": Variant("GM3: commanded speed as wheel speed; KBM: commands", True, False, False),
    "E": Variant("realised acceleration and curvature to both", False, True, True),
}

# after GM3, Fig. 8: length and speeds; curvature per second of the manoeuvre in 1/m
_STEP_S = 0.1


def _command(
    duration_s: float, acceleration: float, curvature: float, start_s: float, stop_s: float
) -> Float[Tensor, "T 2"]:
    times = _STEP_S * torch.arange(round(duration_s / _STEP_S), dtype=torch.float64)
    on = ((times >= start_s) & (times < stop_s)).double()
    return torch.stack([torch.full_like(times, acceleration), curvature * on], -1)


class CommandProfile(NamedTuple):
    """Acceleration (m/s²) and curvature (1/m) over one manoeuvre of the comparison."""

    speed_mps: float
    command: Float[Tensor, "T 2"]


def command_profiles() -> dict[str, CommandProfile]:
    """S-curve (3-7 m/s), left and right turn (3-16 m/s), left and right U-turn (3-15 m/s)."""
    right = torch.tensor([1.0, -1.0], dtype=torch.float64)
    first = _command(9.8, 0.45, 0.1, 1.5, 4.0)
    second = _command(9.8, 0.45, -0.1, 4.0, 6.0)
    curve = torch.stack([first[:, 0], first[:, 1] + second[:, 1]], -1)
    turn, back = _command(7.4, 1.8, 0.06, 2.0, 5.0), _command(6.0, 2.0, 0.14, 1.0, 4.5)
    return {
        "S-curve": CommandProfile(3.0, curve),
        "left turn": CommandProfile(3.0, turn),
        "right turn": CommandProfile(3.0, turn * right),
        "left U-turn": CommandProfile(3.0, back),
        "right U-turn": CommandProfile(3.0, back * right),
    }


def _driven(
    model: DynamicsModel, controls: Float[Tensor, "T m"], speed_mps: float
) -> Float[Tensor, "T 2"]:
    """Positions in m after each step from the origin, straight ahead at first."""
    zero = controls.new_zeros(())
    velocity = torch.stack([zero + speed_mps, zero])
    start = model.initial_state(Motion(controls.new_zeros(2), zero, velocity, zero))
    return rollout(model, start, controls)[1:, :2]


def _gm3_path(
    spec: VehicleSpec, signals: Signals, variant: Variant, speed_mps: float
) -> Float[Tensor, "T 2"]:
    given = signals.realised if variant.gm3_realised else signals.command
    kind = DiffGM3WheelSpeed if variant.gm3_by_wheel_speed else DiffGM3
    model = kind(spec, _STEP_S).double().requires_grad_(False)
    length = spec.front_m + spec.rear_m
    steer = model.chassis.steering.command_for((length * given[:, 1]).atan())
    speed = signals.speed if variant.gm3_realised else signals.intended_speed
    radii = torch.tensor([w.radius_m for w in spec.wheels if w.driven]).double()
    first = speed.unsqueeze(-1) / radii if variant.gm3_by_wheel_speed else given[:, :1]
    return _driven(model, torch.cat([first, steer.unsqueeze(-1)], -1), speed_mps)


def _kbm_path(
    spec: VehicleSpec, signals: Signals, variant: Variant, speed_mps: float
) -> Float[Tensor, "T 2"]:
    given = signals.realised if variant.kbm_realised else signals.command
    model = DiffKBM(spec, _STEP_S).double().requires_grad_(False)
    controls = torch.stack([given[:, 0], (model.wheelbase() * given[:, 1]).atan()], -1)
    return _driven(model, controls, speed_mps)


class FollowingError(NamedTuple):
    """Average displacement from the truth in m."""

    gm3_m: float
    kbm_m: float


def score(
    spec: VehicleSpec, profile: CommandProfile, variant: Variant, truth: LaggedTruth | None = None
) -> FollowingError:
    """Drive both models over one manoeuvre with the signals of one variant.

    Each model's own reference point starts at the origin: the truth is a point.
    """
    signals = (truth or LaggedTruth())(profile.command, profile.speed_mps, _STEP_S)
    paths = (path(spec, signals, variant, profile.speed_mps) for path in (_gm3_path, _kbm_path))
    gm3, kbm = ((path - signals.position).norm(dim=-1).mean().item() for path in paths)
    return FollowingError(gm3, kbm)
