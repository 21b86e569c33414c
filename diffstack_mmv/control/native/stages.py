"""A problem as stages: one step of the dynamics, and what each time costs.

The costs of all times come from one graph. Times whose costs are the same function of their state,
their control and numbers of their own share it, so that the code is as long as one time.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from diffstack_mmv.control.native.addends import FEWEST, addends
from diffstack_mmv.control.native.lowering import CannotLowerError
from diffstack_mmv.control.native.scalar import (
    CONSTANT,
    LEAF,
    Node,
    Program,
    arguments_of,
    needed,
)

MOST_KINDS = 8
"""Different cost functions along a horizon; more are no function of the time."""


class Sizes(NamedTuple):
    """Numbers of states, controls, steps and parameters of a problem."""

    n: int
    m: int
    steps: int
    parameters: int


class Stage(NamedTuple):
    """A function of a state, a control and numbers q: leaves ("x", i), ("u", j), ("q", k)."""

    program: Program
    outputs: tuple[Node, ...]
    numbers: int  # of q
    is_cost: bool
    repeated: "Repeated | None" = None  # what is added to the output

    @property
    def own_numbers(self) -> int:
        """Numbers before those of the repeated terms."""
        return self.numbers - (self.repeated.total if self.repeated else 0)


class Repeated(NamedTuple):
    """A sum of like terms: leaves ("r", i) are the numbers of each, which follow one another."""

    term: Stage
    count: int

    @property
    def total(self) -> int:
        """Numbers of all terms."""
        return self.count * self.term.numbers


class Placed(NamedTuple):
    """A stage at one time, and where its numbers q stand among those of the problem."""

    key: tuple[Any, ...]
    origins: tuple[Node, ...]  # nodes of the problem that depend on its parameters alone


class OwnNumber(NamedTuple):
    """The line of a key for a number that comes from the parameters alone."""

    index: int  # among those of its stage
    is_truth: bool


class StagedProblem(NamedTuple):
    """A problem ready for code."""

    sizes: Sizes
    parameters: Program  # what is computed from the parameters alone, once per solve
    numbers: tuple[Node, ...]  # nodes of it that the stages read
    step: Stage  # n outputs
    step_numbers: tuple[int, ...]  # positions of its q in `numbers`
    costs: tuple[Stage, ...]  # one output each
    kinds: tuple[int, ...]  # which of them each time has
    cost_numbers: tuple[tuple[int, ...], ...]  # positions of their q in `numbers`, for each time


class StagedStep(NamedTuple):
    """One step of a row ready for code: leaves ("x", i), ("u", j), ("q", k) of its stage."""

    state: int  # n of its results are the following state
    inputs: int
    parameters: int
    prelude: Program  # what is computed from the parameters alone
    numbers: tuple[Node, ...]  # nodes of it that the stage reads, in the order of its q
    step: Stage


def staged_step(
    program: Program, results: Sequence[Node], state: int, inputs: int, parameters: int
) -> StagedStep:
    """A program with leaves ("x", 0, i), ("u", 0, j) and ("p", k) as one stage."""
    step = _placed(program, results, 0, _known_before(program))
    prelude, numbers = _copied(program, step.origins)
    return StagedStep(state, inputs, parameters, prelude, numbers, _stage(step, False))


def staged(
    program: Program, following: Sequence[Node], costs: Sequence[Node], sizes: Sizes
) -> StagedProblem:
    """Split a program with leaves ("x", t, i), ("u", t, j) and ("p", k) into stages.

    Raises:
        CannotLowerError: The cost of one time sees the state of another, or there are too many
            kinds of costs.
    """
    parts = _parts(program, costs)
    own = _known_before(program)
    step = _placed(program, following, 0, own)
    placed = [_placed_cost(program, *part, time, own) for time, part in enumerate(parts)]
    keys = list(dict.fromkeys(each.key for each in placed))
    if len(keys) > MOST_KINDS:
        raise CannotLowerError(f"{len(keys)} different costs along the horizon")
    origins = list(dict.fromkeys(node for each in [step, *placed] for node in each.origins))
    before, numbers = _copied(program, origins)
    position = {node: index for index, node in enumerate(origins)}

    def positions(each: Placed) -> tuple[int, ...]:
        return tuple(position[node] for node in each.origins)

    return StagedProblem(
        sizes,
        before,
        numbers,
        _stage(step, False),
        positions(step),
        tuple(_cost_stage(placed[[each.key for each in placed].index(key)]) for key in keys),
        tuple(keys.index(each.key) for each in placed),
        tuple(positions(each) for each in placed),
    )


def _parts(program: Program, costs: Sequence[Node]) -> list[tuple[Node, list[Node]]]:
    """What each cost is beside its like terms, and these."""
    own, parts = _known_before(program), []
    for time, cost in enumerate(costs):
        every = addends(program, cost, own)
        if len(every) < FEWEST:
            parts.append((cost, []))
            continue
        groups = defaultdict(list)
        own = _known_before(program, own)  # the terms under their factors are new nodes
        for node in every:
            groups[_placed(program, [node], time, own).key].append(node)
        like = max(groups.values(), key=len)
        if len(like) < FEWEST:
            parts.append((cost, []))
            continue
        chosen = set(like)
        parts.append((program.total(node for node in every if node not in chosen), like))
    return parts


def _placed_cost(
    program: Program, base: Node, like: Sequence[Node], time: int, own: np.ndarray
) -> Placed:
    """A cost with its like terms, whose numbers follow its own."""
    own_part = _placed(program, [base], time, own)
    if not like:
        return own_part
    terms = [_placed(program, [node], time, own) for node in like]
    origins = (node for term in terms for node in term.origins)
    key = (own_part.key, len(own_part.origins), terms[0].key, len(terms))
    return Placed(key, (*own_part.origins, *origins))


def _cost_stage(placed: Placed) -> Stage:
    """The program of the key of a cost."""
    *_, last = placed.key
    if isinstance(last, tuple):  # the outputs: there are no like terms
        return _stage(placed, True)
    base, own_numbers, term, count = placed.key
    per_term = (len(placed.origins) - own_numbers) // count
    each = _stage(Placed(term, placed.origins[:per_term]), True, "r")
    stage = _stage(Placed(base, placed.origins[:own_numbers]), True)
    return stage._replace(numbers=len(placed.origins), repeated=Repeated(each, count))


def _known_before(program: Program, begun: np.ndarray | None = None) -> np.ndarray:
    """Which nodes depend on parameters and constants alone; `begun` tells it of the first ones."""
    known = np.zeros(len(program), dtype=bool)
    first = 0 if begun is None else len(begun)
    known[:first] = False if begun is None else begun
    for node in range(first, len(program)):
        operation = program.operations[node]
        if operation[0] == LEAF:
            known[node] = operation[1] == "p"
        else:
            known[node] = all(known[argument] for argument in arguments_of(program, node))
    return known


def _placed(program: Program, outputs: Sequence[Node], time: int, own: np.ndarray) -> Placed:
    """The operations from outputs down to leaves, numbered in the order of their discovery."""
    names: dict[Node, int] = {}
    lines: list[tuple[Any, ...]] = []
    origins: list[Node] = []
    stack = list(reversed(outputs))
    while stack:
        node = stack[-1]
        operation = program.operations[node]
        if node in names:
            stack.pop()
            continue
        is_end = operation[0] in (LEAF, CONSTANT) or own[node]
        missing = [] if is_end else [each for each in operation[1:] if each not in names]
        if missing:
            stack.extend(reversed(missing))
            continue
        stack.pop()
        names[node] = len(lines)
        lines.append(_line(program, node, time, own, names, origins))
    return Placed((*lines, tuple(names[node] for node in outputs)), tuple(origins))


def _line(
    program: Program,
    node: Node,
    time: int,
    own: np.ndarray,
    names: dict[Node, int],
    origins: list[Node],
) -> tuple[Any, ...]:
    operation = program.operations[node]
    if operation[0] == CONSTANT:
        return operation
    if own[node]:
        origins.append(node)
        return OwnNumber(len(origins) - 1, program.is_truth(node))
    if operation[0] != LEAF:
        return (operation[0], *(names[argument] for argument in operation[1:]))
    _, kind, when, index = operation
    if when != time:
        raise CannotLowerError(f"the cost of time {time} sees time {when}")
    return (LEAF, kind, index)


def _stage(placed: Placed, is_cost: bool, numbers: str = "q") -> Stage:
    """The program of a key, whose numbers are leaves of some name."""
    program, nodes = Program(), []
    *lines, outputs = placed.key
    for line in lines:
        nodes.append(_rebuilt(program, line, nodes, numbers))
    return Stage(program, tuple(nodes[index] for index in outputs), len(placed.origins), is_cost)


def _rebuilt(program: Program, line: tuple[Any, ...], nodes: list[Node], numbers: str) -> Node:
    if isinstance(line, OwnNumber):
        number = program.leaf(numbers, line.index)
        return program.truth(number) if line.is_truth else number
    if line[0] == CONSTANT:
        return program.constant(line[1])
    if line[0] == LEAF:
        return program.leaf(*line[1:])
    return program.apply(line[0], *(nodes[index] for index in line[1:]))


def _copied(program: Program, wanted: Iterable[Node]) -> tuple[Program, tuple[Node, ...]]:
    """A program with what some nodes need alone, truths as numbers at its end."""
    copy, names = Program(), {}
    wanted = list(wanted)
    for node in needed(program, wanted):
        operation = program.operations[node]
        if operation[0] == LEAF:
            names[node] = copy.leaf(*operation[1:])
        elif operation[0] == CONSTANT:
            names[node] = copy.constant(operation[1])
        else:
            names[node] = copy.apply(operation[0], *(names[each] for each in operation[1:]))
    return copy, tuple(copy.number(names[node]) for node in wanted)
