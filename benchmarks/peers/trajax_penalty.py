"""Trajax's iterative LQR (JAX), vectorised over problems; its box is a quadratic penalty."""

import jax
import jax.numpy as jnp
import numpy as np
from trajax import optimizers

from peers import driving
from peers.in_jax import recorder

PENALTY = 100.0
jax.tree_map = jax.tree_util.tree_map  # taken away by newer versions; the gradient calls it


def build(steps, variant):
    """A function from one state and its parameters to states (T + 1, 4) and controls (T, 2)."""
    lower, upper = jnp.array(variant.lower), jnp.array(variant.upper)

    def dynamics(state, control, time):
        return jnp.stack(driving.step(jnp, tuple(state), tuple(control)))

    def solve_one(state, p):
        def cost(state, control, time):
            outside = jnp.maximum(control - upper, 0) + jnp.maximum(lower - control, 0)
            running = driving.stage_cost(jnp, tuple(state), tuple(control), p, variant)
            running = running + PENALTY * (outside**2).sum()
            return jnp.where(time == steps, driving.final_cost(tuple(state), p), running)

        zero = jnp.zeros((steps, 2))
        return optimizers.ilqr(cost, dynamics, state, zero, maxiter=100)[:2]

    return solve_one


def prepare(states, parameters, steps, variant):
    """A function that returns the controls (count, T, 2), from zero controls."""
    solve_all = jax.jit(jax.vmap(build(steps, variant)))
    arguments = jnp.array(states, jnp.float32), jnp.array(parameters, jnp.float32)
    return lambda: np.asarray(solve_all(*arguments)[1], float)


def prepare_gradient(states, parameters, steps):
    """See `recorder`; of the free variant."""
    return recorder(build(steps, driving.FREE), states, parameters)
