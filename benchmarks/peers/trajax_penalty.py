"""Trajax's iterative LQR (JAX), vectorised over problems; its box is a quadratic penalty."""

import jax
import jax.numpy as jnp
import numpy as np
from trajax import optimizers

from peers import driving

PENALTY = 100.0


def prepare(states, parameters, steps):
    """A function that returns the controls (count, T, 2), from zero controls."""
    lower, upper = jnp.array(driving.LOWER), jnp.array(driving.UPPER)

    def dynamics(state, control, time):
        return jnp.stack(driving.step(jnp, tuple(state), tuple(control)))

    def solve_one(state, p):
        def cost(state, control, time):
            outside = jnp.maximum(control - upper, 0) + jnp.maximum(lower - control, 0)
            running = driving.stage_cost(jnp, tuple(state), tuple(control), p)
            running = running + PENALTY * (outside**2).sum()
            return jnp.where(time == steps, driving.final_cost(tuple(state), p), running)

        zero = jnp.zeros((steps, 2))
        return optimizers.ilqr(cost, dynamics, state, zero, maxiter=100)[1]

    solve_all = jax.jit(jax.vmap(solve_one))
    arguments = jnp.array(states, jnp.float32), jnp.array(parameters, jnp.float32)

    def solve():
        return np.asarray(solve_all(*arguments), float)

    return solve
