"""Small optimal-control problems whose callables hide their tensors, as users write them."""

import torch

from diffstack_mmv.control import Bounds

DT = 0.1


def rate_model(wheelbase):
    """Kinematic bicycle: state (x, y, heading, speed), control (acceleration, steer)."""

    def step(state, control):
        x, y, heading, speed = state.unbind(-1)
        acceleration, steer = control.unbind(-1)
        return torch.stack(
            [
                x + DT * speed * heading.cos(),
                y + DT * speed * heading.sin(),
                heading + DT * speed / wheelbase * steer.tan(),
                speed + DT * acceleration,
            ],
            -1,
        )

    return step


def goal_cost(goal, weight):
    """Distance to a goal, effort, and a bump in the way; `goal` is (*b, 2), `weight` is (3,)."""

    def cost(states, controls):
        offset = states[..., :2] - goal.unsqueeze(-2)
        bump = torch.exp(-2 * (states[..., :2] - 0.5 * goal.unsqueeze(-2)).square().sum(-1))
        return (
            weight[0] * offset.square().sum(-1)
            + weight[1] * controls.square().sum(-1)
            + weight[2] * bump
            + 0.1 * (states[..., 3] - 2).square()
        )

    return cost


def driving(batch=(6,), steps=12, limit=3.0, seed=0):
    """Hidden tensors, box and start of a batch of problems; `limit` sets how tight the box is."""
    generator = torch.Generator().manual_seed(seed)
    draw = torch.rand(*batch, 4, generator=generator)
    hidden = {
        "wheelbase": torch.tensor(1.2),
        "weight": torch.tensor([0.2, 0.05, 0.5]),
        "goal": torch.stack([2 + 2 * draw[..., 0], 2 * draw[..., 1] - 1], -1),
        "state": torch.stack(
            [0 * draw[..., 0], 0 * draw[..., 0], draw[..., 2] - 0.5, 1 + draw[..., 3]], -1
        ),
    }
    hidden = {name: value.to(torch.get_default_dtype()) for name, value in hidden.items()}
    box = Bounds(torch.tensor([-limit, -0.2 * limit]), torch.tensor([limit, 0.2 * limit]))
    return hidden, box, torch.zeros(*batch, steps, 2)


def solve(solver, hidden, box, controls):
    """Solve a driving problem from its hidden tensors."""
    dynamics = rate_model(hidden["wheelbase"])
    return solver(
        dynamics, goal_cost(hidden["goal"], hidden["weight"]), box, hidden["state"], controls
    )
