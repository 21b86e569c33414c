"""Trajax's iterative LQR (JAX), vectorised over problems; its box is a quadratic penalty."""

import jax
import jax.numpy as jnp
import numpy as np
from trajax import optimizers

from peers.in_jax import recorder

jax.tree_map = jax.tree_util.tree_map  # taken away by newer versions; the gradient calls it


def build(steps, problem):
    """A function from one state and its parameters to states (T + 1, n) and controls (T, m)."""
    lower, upper = jnp.array(problem.lower), jnp.array(problem.upper)

    def dynamics(state, control, time):
        return jnp.stack(problem.step(jnp, tuple(state), tuple(control)))

    def solve_one(state, p):
        def cost(state, control, time):
            outside = jnp.maximum(control - upper, 0) + jnp.maximum(lower - control, 0)
            running = problem.stage_cost(jnp, tuple(state), tuple(control), p)
            running = running + problem.penalty * (outside**2).sum()
            return jnp.where(time == steps, problem.final_cost(jnp, tuple(state), p), running)

        zero = jnp.zeros((steps, len(problem.lower)))
        return optimizers.ilqr(cost, dynamics, state, zero, maxiter=100)[:2]

    return solve_one


def prepare(states, parameters, steps, problem):
    """A function that returns the controls (count, T, m), from zero controls."""
    solve_all = jax.jit(jax.vmap(build(steps, problem)))
    arguments = jnp.array(states, jnp.float32), jnp.array(parameters, jnp.float32)
    return lambda: np.asarray(solve_all(*arguments)[1], float)


def prepare_gradient(states, parameters, steps, problem):
    """See `recorder`; of problems without bounds."""
    return recorder(build(steps, problem), states, parameters)
