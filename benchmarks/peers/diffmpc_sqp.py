"""Toyota Research Institute's diffmpc (JAX): SQP with conjugate gradients, vectorised over problems.

Without line search, as it comes: with it no more problems end well here. Its conjugate gradients stop
at 1e-6, the loosest of 1e-9, 1e-6 and 1e-4 that costs no quality.
"""

import jax
import jax.numpy as jnp
import numpy as np
from diffmpc.dynamics.base_dynamics import Dynamics
from diffmpc.problems.optimal_control_problem import OptimalControlProblem
from diffmpc.solvers.sqp import SQPSolver
from diffmpc.utils.load_params import load_solver_params

from peers import driving
from peers.in_jax import recorder


class Bicycle(Dynamics):
    """The step, as an Euler step of length one."""

    def state_dot(self, state, control, params=None):
        following = driving.step(jnp, tuple(state), tuple(control))
        return jnp.stack(following) - state


class Driving(OptimalControlProblem):
    """The costs of the free variant; the goal is what it calls the final state."""

    def step_cost(self, state, control, params):
        goal = params["final_state"]
        return driving.stage_cost(jnp, tuple(state), tuple(control), goal, driving.FREE)

    def final_cost(self, state, params):
        return driving.final_cost(tuple(state), params["final_state"])


def build(steps):
    """A function from one state and goal to its solution."""
    bicycle = Bicycle(
        dict(num_states=4, num_controls=2, names_states=[*"xyhv"], names_controls=[*"as"])
    )
    problem_params = {
        "horizon": steps,
        "discretization_resolution": 1.0,
        "discretization_scheme": 0,
        "initial_state": jnp.array([0.0, 0.0, 0.0, 1.0]),
        "final_state": jnp.array([1.0, 0.0, 0.0, 1.0]),
        "reference_state_trajectory": jnp.zeros((steps + 1, 4)),
        "reference_control_trajectory": jnp.zeros((steps + 1, 2)),
        "weights_penalization_reference_state_trajectory": jnp.zeros(4),
        "weights_penalization_control_squared": jnp.zeros(2),
        "weights_penalization_final_state": jnp.zeros(4),
    }
    solver_params = load_solver_params("sqp.yaml")
    solver_params |= dict(tol_convergence=1e-4, num_scp_iteration_max=30)
    solver_params["pcg"]["tol_epsilon"] = 1e-6
    problem = Driving(bicycle, problem_params, check_parameters_are_valid=False)
    solver = SQPSolver(problem, params=solver_params)
    blank = solver.initial_guess()

    def solve_one(state, goal):
        def follow(current, _):
            return jnp.stack(driving.step(jnp, tuple(current), (0.0, 0.0))), current

        path = jax.lax.scan(follow, state, None, steps + 1)[1]
        guess = blank._replace(states=path, controls=jnp.zeros((steps + 1, 2)))
        given = problem_params | {"initial_state": state}
        solution = solver.solve(guess, given, {"final_state": goal})
        return solution.states, solution.controls[:steps]

    return solve_one


def prepare(states, parameters, steps, variant):
    """A function that returns the controls (count, T, 2), from zero controls."""
    solve_all = jax.jit(jax.vmap(build(steps)))
    arguments = jnp.array(states), jnp.array(parameters[:, :4])
    return lambda: np.asarray(solve_all(*arguments)[1])


def prepare_gradient(states, parameters, steps):
    """See `recorder`."""
    return recorder(build(steps), states, parameters)
