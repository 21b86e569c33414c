"""Derivatives of scalar programs, by going backwards through them.

At the kinks the rules are those of torch: half of the slope to each where a maximum is shared, none
where a square root is flat.
"""

from collections.abc import Callable, Mapping, Sequence

from diffstack_mmv.control.native.scalar import Node, Program, arguments_of, needed

Rule = Callable[[Program, Node, tuple[Node, ...]], tuple[Node | None, ...]]
"""(program, the operation, its arguments) -> its partial derivative by each argument."""


def gradient(
    program: Program,
    outputs: Mapping[Node, Node],
    inputs: Sequence[Node],
) -> list[Node]:
    """Derivative of Σ w y by each input, as nodes of the same program.

    Args:
        program: Where all this stands, and is written to.
        outputs: The weight w of every output y.
        inputs: What to differentiate by; they count as independent.
    """
    order = needed(program, outputs, inputs)
    reaches = set(inputs)
    for node in order:
        if any(argument in reaches for argument in arguments_of(program, node)):
            reaches.add(node)
    slopes = dict(outputs)
    for node in reversed(order):
        slope = slopes.get(node)
        if slope is not None and node in reaches:
            _distribute(program, node, slope, reaches, slopes)
    zero = program.constant(0.0)
    return [slopes.get(node, zero) for node in inputs]


def _distribute(
    program: Program, node: Node, slope: Node, reaches: set[Node], slopes: dict[Node, Node]
) -> None:
    arguments = arguments_of(program, node)
    partials = RULES[program.operations[node][0]](program, node, arguments)
    for argument, partial in zip(arguments, partials, strict=True):
        if partial is None or argument not in reaches:
            continue
        part = program.apply("mul", slope, partial)
        if program.value(part) == 0:
            continue
        before = slopes.get(argument)
        slopes[argument] = part if before is None else program.apply("add", before, part)


def _constant(*values: float) -> Rule:
    return lambda p, node, arguments: tuple(p.constant(value) for value in values)


def _none(p: Program, node: Node, arguments: tuple[Node, ...]) -> tuple[None, ...]:
    return (None,) * len(arguments)


def _div(p: Program, node: Node, arguments: tuple[Node, ...]) -> tuple[Node, ...]:
    a, b = arguments
    return p.apply("div", p.constant(1.0), b), p.apply("neg", p.apply("div", node, b))


def _pow(p: Program, node: Node, arguments: tuple[Node, ...]) -> tuple[Node, ...]:
    """No slope where torch tells none: by the base of a power of zero, by the power of a zero."""
    a, b = arguments
    zero = p.constant(0.0)
    lower = p.apply("pow", a, p.apply("sub", b, p.constant(1.0)))
    by_base = p.apply("where", p.apply("eq", b, zero), zero, p.apply("mul", b, lower))
    flat = p.apply("and", p.apply("eq", a, zero), p.apply("ge", b, zero))
    by_power = p.apply("where", flat, zero, p.apply("mul", node, p.apply("log", a)))
    return by_base, by_power


def _fmod(p: Program, node: Node, arguments: tuple[Node, ...]) -> tuple[Node, ...]:
    """The number of times that the divisor was taken off is whole: rounded, it has no slope."""
    a, b = arguments
    times = p.apply("div", p.apply("sub", a, node), b)
    whole = p.apply("floor", p.apply("add", times, p.constant(0.5)))
    return p.constant(1.0), p.apply("neg", whole)


def _larger(name: str) -> Rule:
    def rule(p: Program, node: Node, arguments: tuple[Node, ...]) -> tuple[Node, ...]:
        half, zero, one = p.constant(0.5), p.constant(0.0), p.constant(1.0)
        same = p.apply("eq", *arguments)

        def share(a: Node, b: Node) -> Node:
            beyond = p.apply("where", p.apply(name, a, b), one, zero)
            return p.apply("where", same, half, beyond)

        return share(*arguments), share(*reversed(arguments))

    return rule


def _atan2(p: Program, node: Node, arguments: tuple[Node, ...]) -> tuple[Node, ...]:
    a, b = arguments
    square = p.apply("add", p.apply("mul", a, a), p.apply("mul", b, b))
    return p.apply("div", b, square), p.apply("neg", p.apply("div", a, square))


def _where(p: Program, node: Node, arguments: tuple[Node, ...]) -> tuple[Node | None, ...]:
    one, zero, condition = p.constant(1.0), p.constant(0.0), arguments[0]
    return None, p.apply("where", condition, one, zero), p.apply("where", condition, zero, one)


def _unary(slope: Callable[[Program, Node, Node], Node]) -> Rule:
    """A rule from (program, the value, its argument) -> derivative."""
    return lambda p, node, arguments: (slope(p, node, arguments[0]),)


def _reciprocal(p: Program, node: Node) -> Node:
    return p.apply("div", p.constant(1.0), node)


def _square(p: Program, node: Node) -> Node:
    return p.apply("mul", node, node)


def _one_less_square(p: Program, node: Node) -> Node:
    return p.apply("sub", p.constant(1.0), _square(p, node))


def _one_and_square(p: Program, node: Node) -> Node:
    return p.apply("add", p.constant(1.0), _square(p, node))


def _arc(p: Program, a: Node) -> Node:
    return _reciprocal(p, p.apply("sqrt", _one_less_square(p, a)))


def _erf(p: Program, y: Node, a: Node) -> Node:
    bell = p.apply("exp", p.apply("neg", _square(p, a)))
    return p.apply("mul", p.constant(2.0 / 3.141592653589793**0.5), bell)


RULES: dict[str, Rule] = {
    "add": _constant(1.0, 1.0),
    "sub": _constant(1.0, -1.0),
    "mul": lambda p, node, arguments: (arguments[1], arguments[0]),
    "div": _div,
    "pow": _pow,
    "max": _larger("gt"),
    "min": _larger("lt"),
    "atan2": _atan2,
    "where": _where,
    "neg": _constant(-1.0),
    "abs": _unary(lambda p, y, a: p.apply("sign", a)),
    "sqrt": _unary(lambda p, y, a: p.apply("div", p.constant(0.5), y)),
    "exp": _unary(lambda p, y, a: y),
    "log": _unary(lambda p, y, a: _reciprocal(p, a)),
    "sin": _unary(lambda p, y, a: p.apply("cos", a)),
    "cos": _unary(lambda p, y, a: p.apply("neg", p.apply("sin", a))),
    "tan": _unary(lambda p, y, a: _one_and_square(p, y)),
    "atan": _unary(lambda p, y, a: _reciprocal(p, _one_and_square(p, a))),
    "asin": _unary(lambda p, y, a: _arc(p, a)),
    "acos": _unary(lambda p, y, a: p.apply("neg", _arc(p, a))),
    "sinh": _unary(lambda p, y, a: p.apply("cosh", a)),
    "cosh": _unary(lambda p, y, a: p.apply("sinh", a)),
    "tanh": _unary(lambda p, y, a: _one_less_square(p, y)),
    "log1p": _unary(lambda p, y, a: _reciprocal(p, p.apply("add", p.constant(1.0), a))),
    "expm1": _unary(lambda p, y, a: p.apply("add", p.constant(1.0), y)),
    "erf": _unary(_erf),
    "fmod": _fmod,
    **dict.fromkeys(("lt", "le", "gt", "ge", "eq", "ne", "and", "or"), _none),
    **dict.fromkeys(("not", "sign", "floor", "ceil"), _none),
}
