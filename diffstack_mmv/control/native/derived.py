"""Stages with their derivatives."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from diffstack_mmv.control.native.derivative import gradient
from diffstack_mmv.control.native.scalar import Node, Program, needed
from diffstack_mmv.control.native.stages import Sizes, Stage

LONGEST_GRADIENT = 1500
"""Operations of a gradient beyond which its derivatives are not even tried to be written out."""


class Derived(NamedTuple):
    """A stage with its gradient by state and control, weighted by leaves ("l", i)."""

    stage: Stage
    gradient: tuple[Node, ...]
    jacobian: tuple[Node, ...]  # (outputs, n + m)
    hessian: tuple[Node, ...] | None  # of the weighted sum of the outputs; None: too long
    active: tuple[int, ...]  # columns of the Jacobian of the stage that are not constant
    constants: tuple[tuple[float, ...], ...]  # that Jacobian, zero where it is not constant
    term: "Derived | None" = None  # of the like terms, where these are written out by themselves


def derived(stage: Stage, sizes: Sizes) -> Derived:
    """Differentiate a stage."""
    n, m, *_ = sizes
    program = stage.program
    inputs = [program.leaf("x", i) for i in range(n)] + [program.leaf("u", j) for j in range(m)]
    one = program.constant(1.0)
    jacobian = [gradient(program, {output: one}, inputs) for output in stage.outputs]
    values = [[program.value(entry) for entry in row] for row in jacobian]
    constants = tuple(tuple(0.0 if v is None else v for v in row) for row in values)
    active = {i for i in range(n + m) if any(row[i] is None for row in values)}
    slopes = tuple(weighted_gradient(stage, inputs))
    flat = tuple(entry for row in jacobian for entry in row)
    known = stage, slopes, flat
    term = derived(stage.repeated.term, sizes) if stage.repeated else None
    if term is not None and term.hessian is None:
        return Derived(*known, None, tuple(sorted(active | set(term.active))), constants)
    hessian = _hessian(stage, slopes, inputs)
    return Derived(*known, hessian, tuple(sorted(active)), constants, term)


def _hessian(
    stage: Stage, slopes: Sequence[Node], inputs: Sequence[Node]
) -> tuple[Node, ...] | None:
    program = stage.program
    if len(needed(program, slopes)) > LONGEST_GRADIENT:
        return None
    one = program.constant(1.0)
    return tuple(entry for slope in slopes for entry in gradient(program, {slope: one}, inputs))


def weighted_gradient(stage: Stage, inputs: Sequence[Node]) -> list[Node]:
    """Gradient of Σ l_i y_i by some leaves; of a cost, which has no weight, of its value."""
    program, outputs = stage.program, stage.outputs
    if stage.is_cost:
        return gradient(program, {outputs[0]: program.constant(1.0)}, inputs)
    return gradient(program, weighted(program, outputs, "l"), inputs)


def weighted(program: Program, outputs: Iterable[Node], name: str) -> dict[Node, Node]:
    """A weight, leaf (name, i), of each output; those of one node are added."""
    weights: dict[Node, Node] = {}
    for index, output in enumerate(outputs):
        weight = program.leaf(name, index)
        before = weights.get(output)
        weights[output] = weight if before is None else program.apply("add", before, weight)
    return weights
