"""Box-constrained trajectory optimisation with exact second derivatives, batched."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self, overload

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.checks import (
    message,
    require,
    require_at_least,
    require_positive,
    require_precision,
    require_switch,
    require_whole,
)
from diffstack_mmv.control.autocast import autocasts
from diffstack_mmv.control.batch_last import to_batch_last
from diffstack_mmv.control.compilation import (
    Kernels,
    can_compile,
    compiled_kernels,
    eager_kernels,
)
from diffstack_mmv.control.curvature import CurvatureForm, ExactCurvature
from diffstack_mmv.control.definite import definite_policies
from diffstack_mmv.control.fitting import require_fitting, require_tensors
from diffstack_mmv.control.gradient import Call, GradientMode, Implicit
from diffstack_mmv.control.iteration import OPEN, Iterate, Settings, cheaper, concluded, start
from diffstack_mmv.control.optimizer import Constraints, Cost, Dynamics
from diffstack_mmv.control.selection import Workload
from diffstack_mmv.types import Bounds, Solution, on_host

if TYPE_CHECKING:
    from diffstack_mmv.control.constrained import ConstrainedSolution

CHECK_EVERY = {"cpu": 1}
"""Iterations between two questions whether all are finished; another device would wait for each."""


@dataclass(frozen=True)
class ILQR:
    """Differentiable, batched trajectory optimisation in a box: control-limited DDP.

        min Σ_t c_t(x_t, u_t)  subject to  x_{t+1} = f(x_t, u_t),  lower ≤ u_t ≤ upper,  x_0 given

    Each iteration expands all B·T pairs in one call (f to first order, c + λ · f to second), walks
    a Riccati recursion with an exact box QP at each time, and rolls out all step sizes in one
    batch, keeping the cheapest. Where the exact Hessian of the Lagrangian gives an indefinite Q_uu,
    Q_uu is lifted to the modulus of its curvature, and that problem tries the step of a convex
    model as well (far from the solution: alone): the diagonal of the Hessian over (x_t, u_t) is
    raised at every time until it dominates its rows, and in large models by less after every long
    step. Damping of Q_uu grows after a refused step and decays after a long one. Problems converge
    one by one, and a finished one is frozen. What the batch mates of a problem are, NaN and
    infinity included, changes no bit of its answer, eager or compiled (see `separate_lanes`);
    another size of the batch may round it differently.

    A problem has converged when two conditions hold. Its exact model promises a decrease of the
    cost that is below ζ = `tolerance` · Σ|c|, or below what the precision resolves:
    8 ε (Σ|c| + Σ|x c_x| + Σ|u c_u|), and 8 times that if no step size lowers the cost any more;
    what the convex one promises does not count, as it lifts too much. And
    the projected gradient g promises less than √(ζ Σ|c|) to first order, Σ |g_i| |d_i|, where
    d = clip(u - g / diag Q_uu) - u is the step along it in the scale of each control, ζ not below
    the precision: neither the unit of the cost nor those of the controls matter. The last step is
    still taken, so the error after convergence is that of one more Newton step.

    A problem whose controls run off as far as the precision allows, or whose cost does, has no
    minimum and ends as `UNBOUNDED`.

    The solution is differentiable, exactly, in the initial state and in every tensor that the
    callables depend on (see `implicit`); a problem that did not converge contributes a gradient of
    exactly zero. `gradient` replaces this by the derivative of the iterations.

    Args:
        max_iterations: Limit of iterations.
        tolerance: Predicted relative decrease of the cost at which a problem has converged.
        line_search_steps: Number of step sizes 1, ½, ¼, ...
        regularisation: First damping after a refused step, relative to the largest entry of Q_uu.
        curvature: How the iterations come by the curvature of the dynamics: `ExactCurvature`, or
            `DifferencedCurvature` for large models such as DiffGM3. Derivatives of the solution
            are exact in either case.
        gradient: How the solution is differentiated: `Implicit`, or `Unrolled` for comparison.
        compile: Compile the kernels, once per code of the callables (not per closure). Where there
            is no compiler, or the callables do not compile, a warning is logged and they run
            eagerly.
        one_by_one: Number of problems up to which a compiled solver solves each on its own, in a
            library that is generated for their kind: a single one in a fraction of a millisecond.
            On a CPU this is the faster way for any number whose shapes stay the same. Several
            problems need callables that are `Batched`, which tells the tensors of each.

    Raises:
        ValueError: A number is not positive, one that counts is not whole, `compile` is neither
            true nor false, or `Unrolled` is to run compiled kernels.

    Source:
        Tassa et al., Control-Limited Differential Dynamic Programming, ICRA 2014; differs in the
        second-order terms of the dynamics, the convex model and the choice of the step size. Amos
        et al., Differentiable MPC for End-to-end Planning and Control, NeurIPS 2018; differs in
        the full Hessian.

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
        ...     angle, rate = states.unbind(-1)
        ...     effort = 0.01 * torques[..., 0].square()
        ...     return (angle - torch.pi).square() + 0.1 * rate.square() + effort
        >>> box = Bounds(torch.tensor([-5.0]), torch.tensor([5.0]))
        >>> solution = ILQR()(pendulum, cost, box, torch.zeros(8, 2), 0.1 * torch.randn(8, 40, 1))
        >>> solution.controls.square().sum().backward()
        >>> bool(solution.converged.all()), bool(length.grad.isfinite())
        (True, True)
    """

    max_iterations: int = 100
    tolerance: float = 1e-10
    line_search_steps: int = 8
    regularisation: float = 1e-2
    curvature: CurvatureForm = ExactCurvature()
    gradient: GradientMode = Implicit()
    compile: bool = False
    one_by_one: int = 16

    def __post_init__(self) -> None:
        for name, form, example in (
            ("curvature", CurvatureForm, "DifferencedCurvature()"),
            ("gradient", GradientMode, "Unrolled()"),
        ):
            part = getattr(self, name)
            fits = isinstance(part, form) and not isinstance(part, type)
            require(fits, name, f"be a {form.__name__}", repr(part), "", f"For instance {example}.")
        require_positive("tolerance", self.tolerance)
        require_positive("regularisation", self.regularisation)
        for name, least in (("max_iterations", 1), ("line_search_steps", 1), ("one_by_one", 0)):
            require_at_least(name, getattr(self, name), least)
            require_whole(name, getattr(self, name))
        require_switch("compile", self.compile)
        eager = not (self.compile and self.gradient.through_iterations)
        require(eager, "compile", f"be false with {self.gradient}", self.compile)

    @overload
    def __call__(
        self,
        dynamics: Dynamics,
        cost: Cost,
        bounds: Bounds,
        state: Float[Tensor, "*b n"],
        controls: Float[Tensor, "*b T m"],
        constraints: None = None,
    ) -> Solution: ...

    @overload
    def __call__(
        self,
        dynamics: Dynamics,
        cost: Cost,
        bounds: Bounds,
        state: Float[Tensor, "*b n"],
        controls: Float[Tensor, "*b T m"],
        constraints: Constraints,
    ) -> "ConstrainedSolution": ...

    def __call__(
        self,
        dynamics: Dynamics,
        cost: Cost,
        bounds: Bounds,
        state: Float[Tensor, "*b n"],
        controls: Float[Tensor, "*b T m"],
        constraints: Constraints | None = None,
    ) -> Any:
        """Solve from the initial state and a guess of the controls.

        Args:
            dynamics: One step (state, control) -> state of all problems.
            cost: (states, controls padded by a zero row) -> cost of each time.
            bounds: Box of the controls; infinite where there is no bound.
            state: x_0.
            controls: The guess, clipped to the box.
            constraints: What has to hold besides: the default settings of `ConstrainedILQR`, which
                has soft constraints, chosen times and warm starts.

        Returns:
            The `Solution`, a `ConstrainedSolution` with constraints; states and controls of a
            problem that is not finite are zero where they are NaN.

        Raises:
            ValueError: Shapes, precision or the order of the bounds do not fit, or the callables
                return other shapes.
            TypeError: The state is neither float32 nor float64, or something is no tensor.
        """
        if torch.compiler.is_compiling():
            # only what stands around a solve can be compiled from outside
            apart: Any = torch.compiler.disable(type(self).__call__)
            return apart(self, dynamics, cost, bounds, state, controls, constraints)
        if constraints is not None:
            # it is built on this class
            from diffstack_mmv.control.constrained import ConstrainedILQR, listed

            solve = ConstrainedILQR(self)
            return solve(dynamics, cost, listed(constraints), bounds, state, controls)
        require_tensors(bounds, state, controls)
        if autocasts(state.device):
            # products of matrices in half precision would count as converged far from the minimum
            with torch.autocast(state.device.type, enabled=False):
                return self(dynamics, cost, bounds, state, controls)
        check_problem(bounds, state, controls)
        require_fitting(dynamics, cost, state, controls)
        settings = self.settings(bounds, state)
        # the library takes the box as a constant
        learned_box = settings.box.requires_grad and torch.is_grad_enabled()
        if self.compile and not learned_box:
            # imported here: most programs compile nothing
            from diffstack_mmv.control import native

            exact = self.curvature.is_exact(state.shape[-1])
            numbers = native.Numbers(settings, self.max_iterations, exact, self.one_by_one)
            solution = native.solve(dynamics, cost, numbers, state, controls)
            if solution is not None:
                return solution
        call = Call(
            self._kernels(dynamics, cost, state, controls),
            dynamics,
            cost,
            settings,
            state,
            controls,
            self.curvature,
        )
        return self.gradient(self.minimise, call)

    def compiled(self) -> Self:
        """The same solver with its kernels compiled; itself without a compiler or if `Unrolled`."""
        able = not self.gradient.through_iterations and can_compile()
        return replace(self, compile=True) if able else self

    def settings(self, bounds: Bounds, state: Float[Tensor, "*b n"]) -> Settings:
        """The numbers of this solver and the box, in the precision of the state."""
        powers = torch.arange(self.line_search_steps, dtype=state.dtype, device=state.device)
        return Settings(
            torch.stack([bounds.lower, bounds.upper]).to(state),
            0.5**powers,
            state.new_full((), self.tolerance),
            state.new_full((), self.regularisation),
        )

    def _kernels(self, dynamics: Dynamics, cost: Cost, state: Tensor, controls: Tensor) -> Kernels:
        if not self.compile or state.numel() == 0:
            return eager_kernels(self.curvature)
        n, m = state.shape[-1], controls.shape[-1]
        static = (n, m, state.numel() == n, state.dim(), self.line_search_steps)
        return compiled_kernels(self.curvature, dynamics, cost, static, state)

    def minimise(self, call: Call) -> Iterate:
        """Iterate until every problem is finished; the arguments are checked already."""
        kernels, dynamics, cost, settings, state, controls, _ = call
        like = state.new_zeros(state.shape[:-1])
        x0, guess = to_batch_last(state, like), to_batch_last(controls, like).contiguous()
        first = start(kernels.attempt, dynamics, cost, like, x0.contiguous(), guess, settings)
        work = Workload(dynamics, cost, like, first, None, first)
        every = CHECK_EVERY.get(state.device.type, 4)
        for iteration in range(self.max_iterations):
            if iteration % every == 0 and not bool((work.iterate.status == OPEN).any()):
                break
            work = work.narrowed()
            work = work._replace(iterate=self._improve(kernels, settings, work, len(x0)))
        iterate = work.merged()
        return iterate._replace(status=concluded(iterate))

    def _improve(self, kernels: Kernels, settings: Settings, work: Workload, n: int) -> Iterate:
        dynamics, cost, like, iterate = work[:4]
        model = kernels.expand(dynamics, cost, like, iterate.x, iterate.u, iterate.near)
        policies = definite_policies(
            kernels.box_policy,
            model.quadratic,
            model.gradient,
            settings.box,
            iterate.damping,
            model.magnitude,
            iterate.share,
            n,
        )
        iterate = iterate._replace(share=policies.share)
        scale = model.magnitude, model.noise
        first = kernels.attempt(dynamics, cost, like, iterate, *scale, policies.first, settings)
        if policies.second is None:
            return first
        second = kernels.attempt(dynamics, cost, like, iterate, *scale, policies.second, settings)
        return cheaper(iterate, first, second, policies.either)


def check_problem(
    bounds: Bounds, state: Float[Tensor, "*b n"], controls: Float[Tensor, "*b T m"]
) -> None:
    """Refuse arguments that do not fit together.

    Raises:
        ValueError: Leading dimensions, precision or number of controls differ, there is no step, or
            a bound is missing or above its partner. Another device than a CPU is not waited for:
            crossed bounds make every problem there `INFEASIBLE`.
        TypeError: The state is neither float32 nor float64.
    """
    require_precision("state", state.dtype)
    columns = state.dim() >= 1 and state.shape[-1] >= 1
    require(columns, "state", "have a last dimension of columns", tuple(state.shape))
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
    require(controls.shape[-1] >= 1, "controls", "have a column", controls.shape[-1])
    m = controls.shape[-1]
    for name, bound in zip(Bounds._fields, bounds, strict=True):
        require(
            tuple(bound.shape) == (m,),
            f"bounds.{name}",
            f"have shape ({m},)",
            tuple(bound.shape),
            remedy="A limit of a time or a problem of its own is a constraint.",
        )
    if not on_host(*bounds) or bool((bounds.lower <= bounds.upper).all()):
        return
    for name, bound in zip(Bounds._fields, bounds, strict=True):
        known = not bool(bound.isnan().any())
        remedy = "Write ±inf where there is none."
        require(known, f"bounds.{name}", "be numbers", bound.tolist(), "", remedy)
    found = bounds.lower.tolist(), bounds.upper.tolist()
    raise ValueError(message("bounds", "be in order, lower <= upper", found))
