"""What happens at every wheel: loads, slips and forces, for figures and checks."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.dynamics.gm3.held import unpack
from diffstack_mmv.dynamics.gm3.model import DiffGM3, as_columns
from diffstack_mmv.dynamics.gm3.tire import forces


class WheelForces(NamedTuple):
    """Quantities of all wheels in the order of the vehicle's; zero at casters but for the load."""

    force_x: Float[Tensor, "*b wheels"]  # N, forward in the wheel's axes
    force_y: Float[Tensor, "*b wheels"]  # N, to the left
    moment_z: Float[Tensor, "*b wheels"]  # N m, before the vehicle's k_align
    normal_load: Float[Tensor, "*b wheels"]  # N
    steer: Float[Tensor, "*b wheels"]  # rad
    slip_x: Float[Tensor, "*b wheels"]
    slip_y: Float[Tensor, "*b wheels"]
    spin: Float[Tensor, "*b wheels"]  # 1/m
    wheel_speed: Float[Tensor, "*b wheels"]  # rad/s
    friction_limit: Float[Tensor, "*b wheels"]  # μ F_z in N


def wheel_forces(
    model: DiffGM3, state: Float[Tensor, "*b 8"], control: Float[Tensor, "*b m"]
) -> WheelForces:
    """Loads, slips and forces of all wheels under a state and a control."""
    shape = torch.broadcast_shapes(state.shape[:-1], control.shape[:-1])
    held = model.hold(as_columns(control, shape))
    parts = unpack(as_columns(state, shape))
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
        "wheel_speed": contact.grip.traction.rolling / model.chassis.get_buffer("radius"),
    }
    count = len(model.spec.wheels)
    index = model.chassis.get_buffer("rolling_index")
    load = contact.grip.normal_load

    def spread(values: Float[Tensor, "rolling n"]) -> Float[Tensor, "*b wheels"]:
        wide = torch.zeros_like(load).index_copy(0, index, values.expand(-1, load.shape[-1]))
        return wide.mT.reshape(*shape, count)

    loads = load.mT.reshape(*shape, count)
    limit = loads * held.physics.friction.squeeze(-1)
    columns = {name: spread(values) for name, values in rolling.items()}
    return WheelForces(normal_load=loads, friction_limit=limit, **columns)
