"""Brush tyre laws: from slip and spin to forces, and the secants that an implicit step freezes.

All laws share ψ = 2 c_p ℓ² / (3 μ F_z), the inverse of the slip at which the whole contact slides,
and the cubic f(u) = 3u - 3u² + u³ = 1 - (1 - u)³. Positive lateral slip σ_y = -V_y / V_r gives a
force to the left.

Source:
    Cai et al., GM3 (arXiv 2510.07807), Eq. 4-7, and DMMV, Sec. III; Pacejka, Tire and Vehicle
    Dynamics, Ch. 3.
"""

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import message, require_positive, require_tensor
from diffstack_mmv.smooth import soft_clamp, tanh_ratio

LOAD_FLOOR = 1e-5  # N, keeps the slip of full sliding above zero for a wheel in the air
LEAD_LIMIT = 0.9  # of ℓφψ in a vehicle: at 1 the spin alone uses up all friction and ψ* is singular


class TireForces(NamedTuple):
    """Forces of the road on the wheel, in the wheel's own axes."""

    force_x: Float[Tensor, "*b"]  # N, forward
    force_y: Float[Tensor, "*b"]  # N, to the left
    moment_z: Float[Tensor, "*b"]  # N m, counter-clockwise


class TireSlip(NamedTuple):
    """How the contact moves over the road."""

    along: Float[Tensor, "*b"]  # σ_x = (V_r - V_x) / V_r
    across: Float[Tensor, "*b"]  # σ_y = -V_y / V_r
    spin: Float[Tensor, "*b"]  # φ in 1/m
    angle: Float[Tensor, "*b"] | None  # α in rad, None for a law that does not need it


class TireProperties(NamedTuple):
    """What a tyre is like under the load that it carries."""

    grip: Float[Tensor, "*b"]  # μ F_z in N
    cornering: Float[Tensor, "*b"]  # C / 3 = 2 c_p ℓ² / 3 in N
    contact_half_length: Float[Tensor, "*b"]  # ℓ in m
    onset: Float[Tensor, "*b"]  # 1 / ψ = 3 μ F_z / C, the slip of full sliding


def loaded_tire(
    normal_load: Float[Tensor, "*b"],
    friction: Float[Tensor, "*#b"],
    cornering: Float[Tensor, "*#b"],
    contact_half_length: Float[Tensor, "*#b"],
) -> TireProperties:
    """Properties under a load F_z in N; grip and onset stay above zero for a wheel in the air."""
    grip = friction * (normal_load.square() + LOAD_FLOOR**2).sqrt()
    return TireProperties(grip, cornering, contact_half_length, grip / cornering)


class TireSecants(NamedTuple):
    """Forces as products of slips: exact at the slip they were taken at.

    F_x = along · σ_x
    F_y = across · σ_y + per_angle · α + per_spin · φ
    M_z = -aligning · σ_y
    """

    along: Float[Tensor, "*b"]  # N
    across: Float[Tensor, "*b"]  # N
    aligning: Float[Tensor, "*b"]  # N m
    per_spin: Float[Tensor, "*b"] | None = None  # N m
    per_angle: Float[Tensor, "*b"] | None = None  # N / rad


class Tire(ABC):
    """A tyre law. Call it for forces; a vehicle uses its `secants`."""

    uses_slip_angle: ClassVar[bool] = True

    def __repr__(self) -> str:
        numbers = ", ".join(f"{name}={value}" for name, value in vars(self).items())
        return f"{type(self).__name__}({numbers})"

    @abstractmethod
    def secants(
        self, slip: TireSlip, tire: TireProperties, lead: Float[Tensor, "*b"]
    ) -> TireSecants:
        """Secants at a slip; `lead` is ℓφψ, bounded below 1 inside of a vehicle."""

    def secants_in_vehicle(self, slip: TireSlip, tire: TireProperties) -> TireSecants:
        """Secants with the guard that a vehicle needs: ℓφψ softly bounded by `LEAD_LIMIT`."""
        lead = slip.spin * tire.contact_half_length / tire.onset
        return self.secants(slip, tire, soft_clamp(lead, LEAD_LIMIT))

    def __call__(
        self,
        normal_load: Float[Tensor, "*b"],
        slip_x: Float[Tensor, "*b"],
        slip_y: Float[Tensor, "*b"],
        slip_angle: Float[Tensor, "*b"],
        spin: Float[Tensor, "*b"],
        friction: Float[Tensor, "*#b"],
        tread_stiffness: Float[Tensor, "*#b"],
        contact_half_length: Float[Tensor, "*#b"],
    ) -> TireForces:
        """Forces of one tyre or of many.

        Args:
            normal_load: F_z in N; one below zero counts as none, since the road does not pull.
            slip_x: Theoretical slip σ_x, dimensionless.
            slip_y: Theoretical slip σ_y, positive where the contact drifts to the right.
            slip_angle: α = atan2(-V_y, V_x) in rad.
            spin: φ in 1/m.
            friction: μ.
            tread_stiffness: c_p in N/m², per unit of length.
            contact_half_length: ℓ in m.

        Returns:
            F_x and F_y in N, M_z in N m.

        Raises:
            TypeError: An argument is no tensor.
        """
        given = {
            "normal_load": normal_load,
            "slip_x": slip_x,
            "slip_y": slip_y,
            "slip_angle": slip_angle,
            "spin": spin,
            "friction": friction,
            "tread_stiffness": tread_stiffness,
            "contact_half_length": contact_half_length,
        }
        for name, value in given.items():
            require_tensor(name, value)
        third = 2 / 3 * tread_stiffness * contact_half_length.square()
        tire = loaded_tire(normal_load.clamp_min(0), friction, third, contact_half_length)
        slip = TireSlip(slip_x, slip_y, spin, slip_angle)
        lead = spin * contact_half_length / tire.onset
        secants = self.secants(slip, tire, lead)
        return forces(secants, slip)


def forces(secants: TireSecants, slip: TireSlip) -> TireForces:
    """Multiply secants by slips: forces in N, moment in N m."""
    lateral = secants.across * slip.across
    if secants.per_spin is not None:
        lateral = lateral + secants.per_spin * slip.spin
    if secants.per_angle is not None and slip.angle is not None:
        lateral = lateral + secants.per_angle * slip.angle
    return TireForces(secants.along * slip.along, lateral, -secants.aligning * slip.across)


class ConsistentBrush(Tire):
    """The isotropic brush in combined slip, spin acting as an equivalent lateral slip.

        σ_y' = σ_y + ℓφ/3,  s' = sqrt(σ_x² + σ_y'² + ε)
        u = ψ s',  r = max(1 - u, 0),  F(u) = 1 - r³
        F_x = μ F_z F(u) σ_x / s'
        F_y = μ F_z F(u) σ_y' / s'
        M_z = -μ F_z ℓ ψ σ_y r³

    Never leaves the friction circle, is twice continuously differentiable at the onset of sliding
    without any gate, and keeps the camber thrust (2/3) c_p ℓ³ φ. It is written with

        μ F_z F(u) / s' = (C/3) (1 + r + r²) / (u + r)

    which is finite without slip and without load.

    Args:
        epsilon: ε under the root; the stiffness without slip is low by the share ψ sqrt(ε).

    Raises:
        ValueError: ε is not positive.
    """

    uses_slip_angle = False

    def __init__(self, epsilon: float = 1e-20) -> None:
        require_positive("epsilon", epsilon)
        self.epsilon = epsilon

    def secants(
        self, slip: TireSlip, tire: TireProperties, lead: Float[Tensor, "*b"] | None
    ) -> TireSecants:
        """Secants; the law needs no bound on the lead."""
        third_length = tire.contact_half_length / 3
        lateral = torch.addcmul(slip.across, third_length, slip.spin)
        size = (slip.along.square() + lateral.square() + self.epsilon).sqrt()
        slide = size / tire.onset
        rest = torch.relu(1 - slide)
        square = rest.square()
        stiffness = tire.cornering * (1 + rest + square) / (slide + rest)
        aligning = tire.cornering * tire.contact_half_length * (rest * square)
        return TireSecants(stiffness, stiffness, aligning, per_spin=stiffness * third_length)

    def secants_in_vehicle(self, slip: TireSlip, tire: TireProperties) -> TireSecants:
        """Secants; no guard is needed."""
        return self.secants(slip, tire, None)


def _angle_of(slip: TireSlip) -> Float[Tensor, "*b"]:
    """The slip angle in rad of a law that needs it."""
    if slip.angle is None:
        raise ValueError(message("slip.angle", "be given to this law", "nothing"))
    return slip.angle


def _cubic(slide: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """Return f(u) = 3u - 3u² + u³ for u ≥ 0, as printed: not held at 1 above u = 1."""
    return slide * (3 - slide * (3 - slide))


class PaperBrush(Tire):
    """The smooth law of DMMV, letter by letter.

        σ̂ = sqrt(σ_x² + σ_y² + ε),  t = tanh(kα),  ψ* = ψ / (1 - ℓφψ t)
        G(s, p) = 1 / (1 + exp(-k (s - 1/p)))
        F_x = μ F_z (σ_x/σ̂) [(1 - G) f(ψσ̂) + G]
        F_y = (1 - G*) μ F_z (σ_y/σ̂) f(ψ*σ̂) + G* μ F_z t
        M_z = -(1 - G*) μ F_z ℓ ψ* σ_y (1 - ψ*σ̂)³

    with G = G(σ̂, ψ) and G* = G(σ̂, ψ*). It has no camber thrust, leaves the friction circle in
    combined slip, and needs k / ψ ≥ 11. One thing is added: ψ is held below `SLIDE_SHARE` · k, as
    for a wheel that leaves the ground the printed law would grow without bound.

    Source:
        DMMV, Sec. III.

    Args:
        steepness: k of the gate in slip units and of the tanh.
        epsilon: ε under the root.

    Raises:
        ValueError: A number is not positive.
    """

    SLIDE_SHARE: ClassVar[float] = 40.0

    def __init__(self, steepness: float = 100.0, epsilon: float = 1e-8) -> None:
        require_positive("steepness", steepness)
        require_positive("epsilon", epsilon)
        self.steepness = steepness
        self.epsilon = epsilon

    def _gate(
        self, size: Float[Tensor, "*b"], onset: Float[Tensor, "*b"]
    ) -> tuple[Float[Tensor, "*b"], Float[Tensor, "*b"]]:
        """Return G and 1 - G, each to full relative precision."""
        excess = self.steepness * (size - onset)
        return torch.sigmoid(excess), torch.sigmoid(-excess)

    def secants(
        self, slip: TireSlip, tire: TireProperties, lead: Float[Tensor, "*b"]
    ) -> TireSecants:
        """Secants of the printed law."""
        angle = _angle_of(slip)
        size = (slip.along.square() + slip.across.square() + self.epsilon).sqrt()
        sided = self.steepness * tanh_ratio(self.steepness * angle)  # tanh(kα) / α
        onset = tire.onset.clamp_min(1 / (self.SLIDE_SHARE * self.steepness))
        onset_spin = onset * (1 - lead * sided * angle)  # 1 / ψ*
        limit = tire.grip
        gate, stick = self._gate(size, onset)
        gate_spin, stick_spin = self._gate(size, onset_spin)
        slide = size / onset_spin
        along = limit / size * (stick * _cubic(size / onset) + gate)
        across = limit / size * stick_spin * _cubic(slide)
        lever = limit * tire.contact_half_length / onset_spin
        aligning = stick_spin * lever * (1 - slide) ** 3
        return TireSecants(along, across, aligning, per_angle=gate_spin * limit * sided)


class SharpBrush(Tire):
    """The law of GM3 as printed, the cubic read as odd: sgn(u) f(|u|).

        ψ* = ψ / (1 - ℓφψ sgn α)
        F_x = μ F_z (σ_x/σ) f(ψσ), sliding (ψσ > 1): μ F_z σ_x/σ
        F_y = μ F_z sgn(ψ*σ_y) f(|ψ*σ_y|) + (2/3) c_p ℓ³ φ, sliding (|ψ*σ_y| > 1): μ F_z sgn α
        M_z = -μ F_z ℓ ψ* σ_y (1 - |ψ*σ_y|)³, sliding: 0

    It jumps at σ_y = 0 and at the onset of sliding, and leaves the friction circle; for comparison
    only.

    Source:
        GM3, Eq. 4-7.
    """

    def secants(
        self, slip: TireSlip, tire: TireProperties, lead: Float[Tensor, "*b"]
    ) -> TireSecants:
        """Secants of the printed law, with their limits at zero slip."""
        angle = _angle_of(slip)
        onset = tire.onset
        onset_spin = onset * (1 - lead * angle.sign())
        limit = tire.grip
        tiny = torch.finfo(angle.dtype).tiny ** 0.5
        size = (slip.along.square() + slip.across.square()).clamp_min(tiny**2).sqrt()
        side = slip.across.abs().clamp_min(tiny)
        slide, slide_side = size / onset, side / onset_spin
        adhesion = slide_side <= 1
        zero = torch.zeros_like(slide_side)
        per_spin = tire.cornering * tire.contact_half_length
        return TireSecants(
            along=limit / size * _cubic(slide.clamp_max(1)),
            across=torch.where(adhesion, limit / side * _cubic(slide_side.clamp_max(1)), zero),
            aligning=limit
            * tire.contact_half_length
            / onset_spin
            * (1 - slide_side.clamp_max(1)) ** 3,
            per_spin=torch.where(adhesion, per_spin, zero),
            per_angle=torch.where(adhesion, zero, limit / angle.abs().clamp_min(tiny)),
        )
