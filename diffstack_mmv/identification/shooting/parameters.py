"""The learnable physical parameters of a model as one vector, with their priors."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import require_one_of
from diffstack_mmv.dynamics import DynamicsModel
from diffstack_mmv.identification.shooting.block_arrowhead import StepBounds
from diffstack_mmv.identification.shooting.priors import Prior
from diffstack_mmv.vehicles import SoftClamped, VehicleSpec

RANGE_IN_DEVIATIONS = 4.0  # a prior range is read as plus and minus two standard deviations
MAX_SHARE_OF_RANGE = 0.998  # of the half range: beyond, the soft clamp has hardly any slope


class ParameterVector:
    """All learnable numbers, v = middle + half · tanh(raw + θ) with one θ for each.

    Parameters of wheels that are tied share a θ; their first wheel stands for all of them.

    Args:
        model: The dynamics, in its working precision.
        spec: The vehicle it was built from, for the names of the wheels.
        names: Names of the parameters to learn; all learnable ones by default.

    Raises:
        ValueError: A name is not one of the learnable parameters of the model.
    """

    def __init__(
        self, model: DynamicsModel, spec: VehicleSpec, names: Sequence[str] | None = None
    ) -> None:
        clamped = {n: m for n, m in model.named_modules() if isinstance(m, SoftClamped)}
        free = {
            name: module
            for name, module in clamped.items()
            if module.spec.learn and bool((module.get_buffer("half_range") > 0).all())
        }
        for name in names or ():
            require_one_of("parameters", name, tuple(free), f"for vehicle '{spec.name}'")
        self.modules = {n: m for n, m in free.items() if names is None or n in names}
        self.names: list[str] = []
        self.units: list[str] = []
        wheels = [wheel.name for wheel in spec.wheels]
        columns: dict[str, list[Tensor]] = {"middle": [], "half_range": [], "raw": []}
        for name, module in self.modules.items():
            count = module.offset.numel()
            self.names += [name] if module.offset.dim() == 0 else [f"{name}.{w}" for w in wheels]
            self.units += [module.unit] * count
            for column, parts in columns.items():
                parts.append(module.get_buffer(column).reshape(-1)[:count].detach())
        like = model.bounds.lower
        empty = like.new_zeros(0)
        self.middle, self.half, self.raw = (
            torch.cat([empty, *parts]) for parts in columns.values()
        )
        self.prior = Prior(
            self.values(torch.zeros_like(self.raw)),
            2 * self.half / RANGE_IN_DEVIATIONS,
            self.middle - self.half,
            self.middle + self.half,
        )

    def __len__(self) -> int:
        """How many numbers may move."""
        return len(self.names)

    def start(self) -> Float[Tensor, " p"]:
        """θ of the present offsets of the model."""
        offsets = [module.offset.detach().reshape(-1) for module in self.modules.values()]
        return torch.cat([self.raw.new_zeros(0), *offsets])

    def values(self, theta: Float[Tensor, "*b p"]) -> Float[Tensor, "*b p"]:
        """Physical values."""
        return self.middle + self.half * torch.tanh(self.raw + theta)

    def slope(self, theta: Float[Tensor, "*b p"]) -> Float[Tensor, "*b p"]:
        """Derivative dv/dθ."""
        return self.half * (1 - torch.tanh(self.raw + theta).square())

    def theta_for(self, values: Float[Tensor, "*b p"]) -> Float[Tensor, "*b p"]:
        """θ of physical values, which are clipped to where the soft clamp has a slope."""
        ratio = ((values - self.middle) / self.half).clamp(-MAX_SHARE_OF_RANGE, MAX_SHARE_OF_RANGE)
        return torch.atanh(ratio) - self.raw

    def step_bounds(self, theta: Float[Tensor, " p"]) -> StepBounds:
        """How far each value may still move, in its prior standard deviations."""
        values, (low, high) = self.values(theta), self._ends
        return StepBounds((low - values) / self.prior.std, (high - values) / self.prior.std)

    @property
    def _ends(self) -> tuple[Tensor, Tensor]:
        """Least and largest value that a step may reach."""
        reach = MAX_SHARE_OF_RANGE * self.half
        return self.middle - reach, self.middle + reach

    def moved(
        self, theta: Float[Tensor, " p"], deviations: Float[Tensor, " p"]
    ) -> Float[Tensor, " p"]:
        """θ after a step of the values by so many prior standard deviations, to first order.

        Values above zero move by factors, v exp(d σ / v): what they act by are mostly products, as
        the cornering stiffness 2 c_p ℓ², along which such steps go straight.
        """
        values, change = self.values(theta), deviations * self.prior.std
        factors = values * torch.exp(change / values)
        return self.theta_for(torch.where(self.prior.low > 0, factors, values + change))

    def bounds_of_moves(self, theta: Float[Tensor, " p"]) -> StepBounds:
        """The largest `deviations` of `moved` within the ranges."""
        values, ends = self.values(theta), self._ends
        above = self.prior.low > 0
        changes = (
            torch.where(above, values * torch.log(end / values), end - values) for end in ends
        )
        return StepBounds(*(change / self.prior.std for change in changes))

    def tensors(self, theta: Float[Tensor, " p"], prefix: str = "") -> dict[str, Tensor]:
        """Offsets by their names in the model, for a functional call."""
        parts = theta.split([module.offset.numel() for module in self.modules.values()])
        return {
            f"{prefix}{name}.offset": part.reshape(module.offset.shape)
            for (name, module), part in zip(self.modules.items(), parts, strict=True)
        }

    def store(self, theta: Float[Tensor, " p"]) -> None:
        """Write θ into the offsets of the model."""
        with torch.no_grad():
            for (_, module), part in zip(
                self.modules.items(), self.tensors(theta).values(), strict=True
            ):
                module.offset.copy_(part)

    def calibrated(self, theta: Float[Tensor, " p"]) -> dict[str, float | list[float]]:
        """Values by parameter name, as `VehicleSpec.with_values` takes them; θ is stored."""
        self.store(theta)
        with torch.no_grad():
            return {name: module().tolist() for name, module in self.modules.items()}

    def penalty(self, theta: Float[Tensor, "*b p"]) -> Float[Tensor, "*b p"]:
        """Residual of the prior, (v - mean) / std."""
        return (self.values(theta) - self.prior.mean) / self.prior.std
