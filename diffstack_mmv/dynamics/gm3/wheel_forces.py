"""What happens at every wheel: loads, slips and forces, for figures and checks."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.gm3.tire import forces
from diffstack_mmv.dynamics.gm3.zero_order_hold import ZeroOrderHoldDynamics, unpack
from diffstack_mmv.dynamics.records import WheelForces


def forces_at_wheels(
    held: ZeroOrderHoldDynamics, state: Float[Tensor, "8 n"], shape: torch.Size
) -> WheelForces:
    """Loads, slips and forces of all wheels.

    Args:
        held: The dynamics under the control.
        state: States as columns.
        shape: Leading dimensions of the result, n = their product.

    Returns:
        Quantities of all wheels, SI units.
    """
    chassis, parts = held.chassis, unpack(state)
    contact = held.contact(parts.velocity, parts.lean.angle)
    force = forces(contact.secants, contact.slip)
    sine, cosine = held.axes.along[1], held.axes.along[0]
    rolling = {
        "force_x": force.force_x,
        "force_y": force.force_y,
        "moment_z": force.moment_z * contact.grip.trail_sign,
        "steer": torch.atan2(sine, cosine),
        "slip_x": contact.slip.along,
        "slip_y": contact.slip.across,
        "spin": contact.slip.spin,
        "wheel_speed": contact.grip.traction.rolling / chassis.get_buffer("radius"),
    }
    count = len(chassis.spec.wheels)
    index = chassis.get_buffer("rolling_index")
    load = contact.grip.normal_load

    def spread(values: Float[Tensor, "rolling n"]) -> Float[Tensor, "*b wheels"]:
        wide = torch.zeros_like(load).index_copy(0, index, values.expand(-1, load.shape[-1]))
        return wide.mT.reshape(*shape, count)

    loads = load.mT.reshape(*shape, count)
    limit = loads * held.physics.friction.squeeze(-1)
    columns = {name: spread(values) for name, values in rolling.items()}
    return WheelForces(normal_load=loads, friction_limit=limit, **columns)
