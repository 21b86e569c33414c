"""Box-constrained iLQR with exact second derivatives, for a batch of independent problems."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.checks import message, require, require_at_least, require_positive
from diffstack_mmv.control.batch_last import from_batch_last, to_batch_last
from diffstack_mmv.control.definite import definite_policy
from diffstack_mmv.control.expansion import Model, expand
from diffstack_mmv.control.implicit import Optimum, attach, free_controls, reduced_gradient
from diffstack_mmv.control.line_search import Trajectories, search
from diffstack_mmv.control.optimizer import Cost, Dynamics
from diffstack_mmv.control.riccati import Policy
from diffstack_mmv.types import Bounds, Solution, SolverStatus

OPEN = -1  # a problem that is still being solved
NOISE = 8.0  # multiple of the rounding noise of the cost that counts as no decrease
DAMPING_MAX = 1e8
DAMPING_GROWTH, DAMPING_DECAY = 8.0, 0.2


class Iterate(NamedTuple):
    """Where each problem stands."""

    x: Float[Tensor, "T1 n N"]
    u: Float[Tensor, "T m N"]
    cost: Float[Tensor, " N"]
    damping: Float[Tensor, " N"]
    status: Int[Tensor, " N"]
    iterations: Int[Tensor, " N"]


@dataclass(frozen=True)
class ILQR:
    """Differentiable, batched, box-constrained trajectory optimisation: control-limited DDP [TASSA].

        min Σ_t c_t(x_t, u_t)   subject to   x_{t+1} = f(x_t, u_t),   lower ≤ u_t ≤ upper,   x_0 given

    Each iteration expands all B·T pairs in one call (f to first order, c + λ · f to second), walks a Riccati recursion with
    an exact box QP at each time, and rolls out all step sizes in one batch, keeping the cheapest. Where the exact Hessian
    of the Lagrangian gives an indefinite Q_uu, that problem takes the step of the model whose Hessians are projected to the
    nearest positive semidefinite ones. Damping of Q_uu grows after a refused step and decays after a long one. Problems
    converge one by one; a finished one is frozen, and its answer does not depend on its batch mates.

    A problem has converged when its model promises a relative decrease of the cost below `tolerance`, or below what the
    precision resolves: 8 ε (Σ|c| + Σ|x c_x| + Σ|u c_u|), and 8 times that if no step size lowers the cost any more.
    The last step is still taken, so the error after convergence is that of one more Newton step.

    The solution is differentiable, exactly, in the initial state and in every tensor that the callables depend on (see
    `implicit`); a problem that did not converge contributes a gradient of exactly zero.

    Args:
        max_iterations: Limit of iterations.
        tolerance: Predicted relative decrease of the cost at which a problem has converged.
        line_search_steps: Number of step sizes 1, ½, ¼, ...
        regularisation: First damping after a refused step, relative to the largest entry of Q_uu.

    Raises:
        ValueError: A number is not positive.

    Example:
        Swing up a pendulum, and differentiate the effort by its length.

        >>> import torch
        >>> from diffstack_mmv.control import ILQR, Bounds
        >>> length = torch.tensor(1.0, requires_grad=True)
        >>> def pendulum(state, torque):
        ...     angle, rate = state.unbind(-1)
        ...     rate = rate + 0.1 * (torque[..., 0] - 9.81 / length * angle.sin())
        ...     return torch.stack([angle + 0.1 * rate, rate], -1)
        >>> def cost(states, torques):
        ...     return (states[..., 0] - torch.pi).square() + 0.1 * states[..., 1].square() + 0.01 * torques[..., 0].square()
        >>> box = Bounds(torch.tensor([-5.0]), torch.tensor([5.0]))
        >>> solution = ILQR()(pendulum, cost, box, torch.zeros(8, 2), 0.1 * torch.randn(8, 40, 1))
        >>> solution.controls.square().sum().backward()
        >>> bool(solution.converged.all()), bool(length.grad.isfinite())
        (True, True)
    """

    max_iterations: int = 60
    tolerance: float = 1e-10
    line_search_steps: int = 8
    regularisation: float = 1e-2

    def __post_init__(self) -> None:
        require_at_least("max_iterations", self.max_iterations, 1)
        require_positive("tolerance", self.tolerance)
        require_at_least("line_search_steps", self.line_search_steps, 1)
        require_positive("regularisation", self.regularisation)

    def __call__(
        self,
        dynamics: Dynamics,
        cost: Cost,
        bounds: Bounds,
        state: Float[Tensor, "*b n"],
        controls: Float[Tensor, "*b T m"],
    ) -> Solution:
        """Solve from the initial state and a guess of the controls."""
        check_problem(bounds, state, controls)
        with torch.no_grad():
            iterate = self._minimise(dynamics, cost, bounds, state, controls)
            solution, optimum = self._conclude(dynamics, cost, bounds, state, iterate)
        attached = attach(dynamics, cost, state, optimum) if torch.is_grad_enabled() else None
        return solution if attached is None else solution._replace(**attached._asdict())

    def _minimise(
        self, dynamics: Dynamics, cost: Cost, bounds: Bounds, state: Tensor, controls: Tensor
    ) -> Iterate:
        lead = tuple(state.shape[:-1])
        box = torch.stack([bounds.lower, bounds.upper]).to(state)
        sizes = 0.5 ** torch.arange(self.line_search_steps, dtype=state.dtype, device=state.device)
        iterate = self._start(dynamics, cost, lead, box, sizes, state, controls)
        for _ in range(self.max_iterations):
            if not bool((iterate.status == OPEN).any()):
                break
            model = expand(dynamics, cost, lead, iterate.x, iterate.u)
            policy = definite_policy(model.quadratic, iterate.u, box, iterate.damping)
            trial = search(
                dynamics,
                cost,
                lead,
                iterate.x,
                iterate.u,
                policy.k,
                policy.K,
                box,
                sizes,
                NOISE * model.noise,
            )
            iterate = self._advance(iterate, model, policy, trial, box)
        status = torch.where(iterate.status == OPEN, SolverStatus.ITERATION_LIMIT, iterate.status)
        return iterate._replace(status=status)

    def _start(
        self,
        dynamics: Dynamics,
        cost: Cost,
        lead: tuple[int, ...],
        box: Tensor,
        sizes: Tensor,
        state: Tensor,
        controls: Tensor,
    ) -> Iterate:
        """Roll out the guess, clipped to the box."""
        u = to_batch_last(controls, lead).contiguous()
        x0 = to_batch_last(state, lead)
        T, m, N = u.shape
        x = x0.expand(T + 1, *x0.shape).contiguous()
        gains = u.new_zeros(T, m, x.shape[1], N)
        trial = search(
            dynamics, cost, lead, x, u, torch.zeros_like(u), gains, box, sizes, u.new_zeros(N)
        )
        finite = trial.cost.isfinite() & trial.x.isfinite().all(0).all(0)
        status = torch.where(finite, OPEN, SolverStatus.NOT_FINITE)
        zero = torch.zeros_like(trial.cost)
        return Iterate(trial.x, trial.u, trial.cost, zero, status, torch.zeros_like(status))

    def _conclude(
        self, dynamics: Dynamics, cost: Cost, bounds: Bounds, state: Tensor, iterate: Iterate
    ) -> tuple[Solution, Optimum]:
        """Residual and active bounds at the end; a problem that is not finite gives numbers all the same."""
        lead = tuple(state.shape[:-1])
        box = torch.stack([bounds.lower, bounds.upper]).to(state)
        x, u = iterate.x.nan_to_num(), iterate.u
        model = expand(dynamics, cost, lead, x, u)
        gradient = reduced_gradient(model)
        lower, upper = box[0].unsqueeze(-1), box[1].unsqueeze(-1)
        moved = torch.minimum(torch.maximum(u - gradient, lower), upper)
        residual = (u - moved).abs().amax((0, 1)).nan_to_num(nan=torch.inf)
        optimum = Optimum(
            x, u, free_controls(u, gradient, box), iterate.status == SolverStatus.CONVERGED, model
        )
        rows = (x, u, iterate.cost, residual, iterate.iterations, iterate.status)
        return Solution(*(from_batch_last(row, lead) for row in rows)), optimum

    def _advance(
        self, iterate: Iterate, model: Model, policy: Policy, trial: Trajectories, box: Tensor
    ) -> Iterate:
        """Accept or refuse the step of each open problem, adapt its damping and judge whether it is finished."""
        is_open = iterate.status == OPEN
        noise = NOISE * model.noise
        enough = torch.maximum(self.tolerance * model.magnitude, noise)
        settled = (policy.decrease <= enough) & (iterate.damping < 1)
        better = is_open & (trial.cost < iterate.cost)
        settled = settled | (is_open & ~better & (policy.decrease <= NOISE * noise))
        # the cost is flat at its minimum: a last Newton step is good to more digits than the cost can show
        better = better | (is_open & settled & (trial.cost <= iterate.cost + noise))
        damping = self._next_damping(iterate.damping, better, trial.size)
        status = torch.where(is_open & settled, SolverStatus.CONVERGED, iterate.status)
        status = torch.where(
            is_open & ~settled & (damping > DAMPING_MAX), SolverStatus.STALLED, status
        )
        status = torch.where(is_open & ~policy.decrease.isfinite(), SolverStatus.NOT_FINITE, status)
        return Iterate(
            torch.where(better, trial.x, iterate.x),
            torch.where(better, trial.u, iterate.u),
            torch.where(better, trial.cost, iterate.cost),
            torch.where(is_open, damping, iterate.damping),
            status,
            iterate.iterations + is_open.to(iterate.iterations.dtype),
        )

    def _next_damping(self, damping: Tensor, better: Bool[Tensor, " N"], size: Tensor) -> Tensor:
        """Less after a long step, none once it is small, more after a refused one."""
        less = torch.where(size >= 0.5, damping * DAMPING_DECAY, damping)
        less = torch.where(less < 0.1 * self.regularisation, torch.zeros_like(less), less)
        more = (damping * DAMPING_GROWTH).clamp_min(self.regularisation)
        return torch.where(better, less, more)


def check_problem(
    bounds: Bounds, state: Float[Tensor, "*b n"], controls: Float[Tensor, "*b T m"]
) -> None:
    """Refuse arguments that do not fit together.

    Raises:
        ValueError: Leading dimensions, precision or number of controls differ, there is no control, or a bound is
            missing or above its partner.
        TypeError: The state is not of a floating-point type.
    """
    if not state.is_floating_point():
        raise TypeError(message("state", "be of a floating-point type", state.dtype))
    require(
        controls.dtype == state.dtype, "controls", f"be {state.dtype} as the state", controls.dtype
    )
    require(
        controls.dim() == state.dim() + 1,
        "controls",
        "have one dimension more than the state",
        controls.dim(),
    )
    require(
        controls.shape[:-2] == state.shape[:-1],
        "controls",
        f"have the leading dimensions {tuple(state.shape[:-1])} of the state",
        tuple(controls.shape[:-2]),
    )
    require(controls.shape[-2] >= 1, "controls", "cover at least one step", controls.shape[-2])
    m = controls.shape[-1]
    for name, bound in zip(Bounds._fields, bounds, strict=True):
        require(
            tuple(bound.shape) == (m,), f"bounds.{name}", f"have shape ({m},)", tuple(bound.shape)
        )
    in_order = bool((bounds.lower <= bounds.upper).all())
    require(
        in_order,
        "bounds",
        "be in order, lower <= upper",
        (bounds.lower.tolist(), bounds.upper.tolist()),
    )
