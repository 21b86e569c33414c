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

from peers.in_jax import recorder


class Step(Dynamics):
    """The step, as an Euler step of length one."""

    problem = None

    def state_dot(self, state, control, params=None):
        following = self.problem.step(jnp, tuple(state), tuple(control))
        return jnp.stack(following) - state


class Costs(OptimalControlProblem):
    """The costs; the goal is what it calls the final state."""

    problem = None

    def step_cost(self, state, control, params):
        goal = params["final_state"]
        return self.problem.stage_cost(jnp, tuple(state), tuple(control), goal)

    def final_cost(self, state, params):
        return self.problem.final_cost(jnp, tuple(state), params["final_state"])


def build(steps, problem):
    """A function from one state and goal to its solution."""
    n, m = problem.states, len(problem.lower)
    Step.problem = Costs.problem = problem
    names = dict(names_states=[*"xyhv"[:n]], names_controls=[*"as"])
    step = Step(dict(num_states=n, num_controls=m) | names)
    problem_params = {
        "horizon": steps,
        "discretization_resolution": 1.0,
        "discretization_scheme": 0,
        "initial_state": jnp.ones(n),
        "final_state": jnp.zeros(n),
        "reference_state_trajectory": jnp.zeros((steps + 1, n)),
        "reference_control_trajectory": jnp.zeros((steps + 1, m)),
        "weights_penalization_reference_state_trajectory": jnp.zeros(n),
        "weights_penalization_control_squared": jnp.zeros(m),
        "weights_penalization_final_state": jnp.zeros(n),
    }
    solver_params = load_solver_params("sqp.yaml")
    solver_params |= dict(tol_convergence=1e-4, num_scp_iteration_max=30)
    solver_params["pcg"]["tol_epsilon"] = 1e-6
    costs = Costs(step, problem_params, check_parameters_are_valid=False)
    solver = SQPSolver(costs, params=solver_params)
    blank = solver.initial_guess()

    def solve_one(state, goal):
        def follow(current, _):
            return jnp.stack(problem.step(jnp, tuple(current), (0.0,) * m)), current

        path = jax.lax.scan(follow, state, None, steps + 1)[1]
        guess = blank._replace(states=path, controls=jnp.zeros((steps + 1, m)))
        given = problem_params | {"initial_state": state}
        solution = solver.solve(guess, given, {"final_state": goal})
        return solution.states, solution.controls[:steps]

    return solve_one


def prepare(states, parameters, steps, problem):
    """A function that returns the controls (count, T, m), from zero controls."""
    solve_all = jax.jit(jax.vmap(build(steps, problem)))
    arguments = jnp.array(states), jnp.array(parameters[:, : problem.states])
    return lambda: np.asarray(solve_all(*arguments)[1])


def prepare_gradient(states, parameters, steps, problem):
    """See `recorder`."""
    return recorder(build(steps, problem), states, parameters)
