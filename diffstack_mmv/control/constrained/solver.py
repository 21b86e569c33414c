"""Trajectory optimisation with constraints on states and controls, batched and differentiable."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import (
    message,
    require,
    require_at_least,
    require_positive,
    require_switch,
    require_tensor,
    require_whole,
)
from diffstack_mmv.control.autocast import autocasts
from diffstack_mmv.control.constrained.augmented import Approach, AugmentedLagrangian
from diffstack_mmv.control.constrained.conclusion import conclude
from diffstack_mmv.control.constrained.constraint import (
    Constraint,
    ConstraintRows,
    gather,
    require_constraints,
)
from diffstack_mmv.control.constrained.implicit import attach
from diffstack_mmv.control.constrained.local import Problem
from diffstack_mmv.control.constrained.newton import PrimalDual
from diffstack_mmv.control.constrained.phases import FINEST, Phases
from diffstack_mmv.control.constrained.solution import ConstrainedSolution
from diffstack_mmv.control.expansion import pad_controls
from diffstack_mmv.control.fitting import require_fitting, require_tensors
from diffstack_mmv.control.ilqr import ILQR, check_problem
from diffstack_mmv.control.optimizer import Cost, Dynamics
from diffstack_mmv.types import Bounds


@dataclass(frozen=True)
class ConstrainedILQR:
    """Trajectory optimisation in a box with constraints on states and controls.

        min Σ_t c_t(x_t, u_t)  subject to  x_{t+1} = f(x_t, u_t),  lower ≤ u_t ≤ upper,
        g(x_t, u_t) ≤ 0,  h(x_t, u_t) = 0  at any of the times 0 .. T,  x_0 given

    Where the solution of `solver` violates no constraint, it is the answer. All other problems go
    through a primal-dual interior-point method with free states (multiple shooting) from the given
    guess, and then through Newton's method on the optimality conditions with the active set fixed,
    which leaves violations of the order of the rounding. Problems that do not come through are
    solved once more with all constraints at a high price (elastic): that gives a solution, or a
    violation that no step lowers, `SolverStatus.INFEASIBLE`; in float32 one below 1.7e-3 is too
    small to tell, and stays `SolverStatus.ITERATION_LIMIT`. Finished problems are frozen, and left
    behind if the callables are `Selectable`; no answer depends on the batch mates.

    A soft constraint has a `Slack`, the price of its violation. With multipliers of a similar
    problem Newton's method comes first, which takes a few iterations where the active set is
    nearly the same.

    The solution, its multipliers and its cost are differentiable, exactly, in the initial state,
    the bounds and every tensor that the callables and prices depend on, the active constraints
    fixed (see `implicit`). A weakly active inequality, reached but without a multiplier, is treated
    as inactive. A problem that did not converge contributes a gradient of exactly zero.

    Args:
        solver: Solves without constraints; its `tolerance` is that of the solution.
        max_iterations: Limit of interior-point iterations of each phase.
        tolerance: Largest violation of a hard constraint, in its unit, in a converged problem; in
            float32 at least 1.2e-5.
        persistent: Whether what the rounds of a compiled solver leave goes through the other
            phases, which find more solutions and take a thousand times as long. Of no account
            where a gradient is taken.

    Raises:
        ValueError: A number is not positive, or no whole one where it counts, or the solver has
            `Unrolled` derivatives.
        TypeError: The solver is no `ILQR`.

    Source:
        Wächter and Biegler, On the implementation of an interior-point filter line-search algorithm
        for large-scale nonlinear programming, Mathematical Programming 106, 2006; Amos et al.,
        Differentiable MPC for End-to-end Planning and Control, NeurIPS 2018, for derivatives;
        differs in the active constraints on states and the full Hessian.

    Example:
        Brake before a wall whose place is learned.

        >>> import torch
        >>> from diffstack_mmv.control import ILQR, Bounds
        >>> from diffstack_mmv.control.constrained import ConstrainedILQR, Inequality
        >>> wall = torch.tensor(2.0, requires_grad=True)
        >>> def cart(state, force):
        ...     place, speed = state.unbind(-1)
        ...     return torch.stack([place + 0.1 * speed, speed + 0.1 * force[..., 0]], -1)
        >>> def cost(states, forces):
        ...     return (states[..., 0] - 3).square() + 0.01 * forces[..., 0].square()
        >>> keep_off = Inequality(lambda states, forces: states[..., :1] - wall)
        >>> box = Bounds(torch.tensor([-9.0]), torch.tensor([9.0]))
        >>> solver = ConstrainedILQR(ILQR())
        >>> solution = solver(cart, cost, [keep_off], box, torch.zeros(4, 2), torch.zeros(4, 30, 1))
        >>> solution.states[:, -1, 0].sum().backward()
        >>> bool(solution.converged.all()), round(float(wall.grad), 2)
        (True, 4.0)
    """

    solver: ILQR = ILQR()
    max_iterations: int = 150
    tolerance: float = 1e-6
    persistent: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.solver, ILQR):
            found = repr(self.solver)
            raise TypeError(message("solver", "be an ILQR", found, "", "Write ILQR()."))
        # it would hold for what touches no constraint alone
        implicit = not self.solver.gradient.through_iterations
        wanted, remedy = "be Implicit() with constraints", "Leave it out."
        require(implicit, "solver.gradient", wanted, self.solver.gradient, "", remedy)
        require_at_least("max_iterations", self.max_iterations, 1)
        require_whole("max_iterations", self.max_iterations)
        require_positive("tolerance", self.tolerance)
        require_switch("persistent", self.persistent)

    def __call__(
        self,
        dynamics: Dynamics,
        cost: Cost,
        constraints: Sequence[Constraint],
        bounds: Bounds,
        state: Float[Tensor, "*b n"],
        controls: Float[Tensor, "*b T m"],
        multipliers: Sequence[Float[Tensor, "*b T1 k"]] | None = None,
    ) -> ConstrainedSolution:
        """Solve from the initial state and a guess of the controls.

        Args:
            dynamics: One step (state, control) -> state of all problems.
            cost: (states, controls padded by a zero row) -> cost of each time.
            constraints: What has to hold, called as the cost is.
            bounds: Box of the controls; infinite where there is no bound.
            state: x_0.
            controls: The guess, clipped to the box.
            multipliers: Those of a similar problem, which make this a warm start.

        Returns:
            The solution, with one tensor of multipliers per constraint.

        Raises:
            ValueError: Shapes, precision, the order of the bounds or a price do not fit.
            TypeError: The state is neither float32 nor float64, or something is no tensor, no
                constraint or no sequence of them.
        """
        if torch.compiler.is_compiling():
            # only what stands around a solve can be compiled from outside
            apart: Any = torch.compiler.disable(type(self).__call__)
            return apart(self, dynamics, cost, constraints, bounds, state, controls, multipliers)
        require_tensors(bounds, state, controls)
        if autocasts(state.device):
            # as in the solver without constraints
            with torch.autocast(state.device.type, enabled=False):
                return self(dynamics, cost, constraints, bounds, state, controls, multipliers)
        check_problem(bounds, state, controls)
        require_fitting(dynamics, cost, state, controls)
        differentiates = torch.is_grad_enabled()
        if not constraints:
            return self._unconstrained(dynamics, cost, bounds, state, controls, ())
        require_constraints(constraints)
        lower, upper = (bound.detach().to(state) for bound in bounds)
        u = controls.detach().clamp(lower, upper)
        # where they are evaluated does not matter: only the shapes do
        standing = state.detach().unsqueeze(-2).expand(*pad_controls(u).shape[:-1], -1)
        rows = gather(constraints, standing, u)
        if sum(rows.widths) == 0:  # such as of nobody to keep clear of
            nothing = rows.linear.detach().split(list(rows.widths), -1)
            return self._unconstrained(dynamics, cost, bounds, state, controls, nothing)
        posed = Problem(dynamics, cost, rows, bounds, state)
        with torch.no_grad():
            fixed = posed.constant()
            given = _given(multipliers, fixed.rows)
            start = None if multipliers is None else PrimalDual(u, given)
            if self.solver.compile and fixed.selectable:
                approach = self._approached(fixed, u, given)
                if not differentiates:
                    return self._completed(fixed, u, approach)
                start = PrimalDual(approach.plain.controls, approach.multipliers)
            phases = self._phases(fixed, exact=differentiates)
            conclusion = conclude(fixed, phases.run(fixed, u, start), exact=differentiates)
        attached = attach(posed, conclusion.point) if differentiates else None
        return conclusion.solution(posed.rows.widths, attached)

    def _unconstrained(
        self,
        dynamics: Dynamics,
        cost: Cost,
        bounds: Bounds,
        state: Tensor,
        controls: Tensor,
        multipliers: tuple[Tensor, ...],
    ) -> ConstrainedSolution:
        plain = self.solver(dynamics, cost, bounds, state, controls)
        return ConstrainedSolution(*plain, torch.zeros_like(plain.cost), multipliers)

    def _approached(self, problem: Problem, u: Tensor, multipliers: Tensor) -> Approach:
        rounds = AugmentedLagrangian(self.solver, self._told(problem))
        return rounds(problem, u, multipliers)

    def _completed(self, problem: Problem, u: Tensor, approach: Approach) -> ConstrainedSolution:
        """The solution, without derivatives; what the approach has not solved goes through all."""
        found = approach.solution(problem)
        index = (~approach.solved).nonzero().squeeze(-1)
        if len(index) == 0 or not self.persistent:
            return found
        rest = problem.select(index)
        start = PrimalDual(approach.plain.controls[index], approach.multipliers[index])
        phases = self._phases(rest, exact=False)
        conclusion = conclude(rest, phases.run(rest, u[index], start), exact=False)
        return found.replaced(index, conclusion.solution(problem.rows.widths, None))

    def _phases(self, problem: Problem, exact: bool) -> Phases:
        # the rounds have a library of their own: one of the bare cost is not worth its time
        plain = replace(self.solver, compile=False) if problem.selectable else self.solver
        return Phases(plain, self.max_iterations, self._told(problem), exact)

    def _told(self, problem: Problem) -> float:
        """Violation that counts as none."""
        return max(self.tolerance, FINEST * torch.finfo(problem.state.dtype).eps)


def _given(multipliers: Sequence[Tensor] | None, rows: ConstraintRows) -> Tensor:
    """The given multipliers side by side, zero where there are none."""
    none = torch.zeros_like(rows.linear)
    if multipliers is None:
        return none
    remedy = "Take those of a solution with the same constraints."
    count, wanted = len(multipliers), len(rows.widths)
    listed = not isinstance(multipliers, Tensor) and count == wanted
    found = "a tensor" if isinstance(multipliers, Tensor) else f"{count} of them"
    require(listed, "multipliers", f"be a list of {wanted}, one per constraint", found, "", remedy)
    for number, (each, width) in enumerate(zip(multipliers, rows.widths, strict=True)):
        name, shape = f"multipliers[{number}]", (*none.shape[:-1], width)
        require_tensor(name, each)
        found = tuple(each.shape)
        require(found == shape, name, f"have shape {shape}", found, remedy=remedy)
    given = torch.cat(list(multipliers), -1).detach().to(none)
    return torch.where(rows.applies, given, none)
