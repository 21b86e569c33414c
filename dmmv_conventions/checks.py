"""The one form in which a bad argument, setting or file is told.

Every message reads "`argument` must requirement, but got value where. remedy".
"""

import difflib
import math
from collections.abc import Iterable, Sequence
from numbers import Integral


def message(
    argument: str, requirement: str, value: object, where: str = "", remedy: str = ""
) -> str:
    """Compose the one form in which a bad argument is told.

    Args:
        argument: Name of the argument, the column or the key at fault.
        requirement: What it must do or be.
        value: What was found.
        where: Place with its preposition ("in a.json"), "" where there is none.
        remedy: One sentence that says what to do.

    Returns:
        The message.
    """
    place = f" {where}" if where else ""
    advice = f" {remedy}" if remedy else ""
    return f"`{argument}` must {requirement}, but got {value}{place}.{advice}"


def require(
    condition: bool,
    argument: str,
    requirement: str,
    value: object,
    where: str = "",
    remedy: str = "",
    error: type[ValueError] = ValueError,
) -> None:
    """Refuse a value; the arguments in the middle are those of `message`.

    Raises:
        ValueError: `condition` is false; of class `error`.
    """
    if not condition:
        raise error(message(argument, requirement, value, where, remedy))


def is_number(value: object) -> bool:
    """Whether something can be compared with numbers: a string, None or a list cannot."""
    return hasattr(value, "__float__")


def _require_no_text(argument: str, value: object, where: str) -> None:
    """Refuse text, which in a message without quotes looks like the number that is asked for."""
    require(not isinstance(value, str), argument, "be a number", repr(value), where)


def require_whole(argument: str, value: object, where: str = "") -> None:
    """Refuse anything but a whole number, which a fraction like 2.0 is not.

    Raises:
        ValueError: `value` is a fraction, a truth, or no number.
    """
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    require(whole, argument, "be a whole number", repr(value), where)


def require_switch(argument: str, value: object, where: str = "") -> None:
    """Refuse anything but true and false, or 1 and 0: text such as "no" would count as true.

    Raises:
        ValueError: `value` is neither.
    """
    require(value in (True, False), argument, "be true or false", repr(value), where)


def require_positive(argument: str, value: float | int, where: str = "", remedy: str = "") -> None:
    """Refuse a number that is not finite and above zero.

    Raises:
        ValueError: `value` is zero, negative, infinite, NaN or text.
    """
    _require_no_text(argument, value, where)
    positive = is_number(value) and math.isfinite(value) and value > 0
    require(positive, argument, "be positive", value, where, remedy)


def require_at_least(
    argument: str, value: float | int, low: float | int, where: str = "", remedy: str = ""
) -> None:
    """Refuse a number below `low`.

    Raises:
        ValueError: `value` is below `low`, NaN or text.
    """
    _require_no_text(argument, value, where)
    enough = is_number(value) and value >= low
    require(enough, argument, f"be at least {low}", value, where, remedy)


def require_between(
    argument: str,
    value: float | int,
    low: float | int,
    high: float | int,
    where: str = "",
    remedy: str = "",
) -> None:
    """Refuse a number outside [low, high].

    Raises:
        ValueError: `value` lies outside the interval, or is NaN or text.
    """
    _require_no_text(argument, value, where)
    inside = is_number(value) and low <= value <= high
    require(inside, argument, f"lie in [{low}, {high}]", value, where, remedy)


def alike(name: str, choices: Iterable[str], count: int = 1, likeness: float = 0.6) -> list[str]:
    """Known names that are most like a wrong one; case does not count.

    Args:
        name: What was given.
        choices: The known names.
        count: How many at most.
        likeness: How much they have in common at least: 1 is everything, 0 is nothing.

    Returns:
        The names as they are known, the most alike first.
    """
    known = {choice.lower(): choice for choice in choices}
    return [known[each] for each in difflib.get_close_matches(name.lower(), known, count, likeness)]


def did_you_mean(name: str, choices: Iterable[str], mark: str = "'", likeness: float = 0.6) -> str:
    """The question whether the known name that is most like a wrong one was meant.

    Args:
        name: What was given; case does not count.
        choices: The known names.
        mark: What stands around the name: a ` around that of a key or an argument.
        likeness: As in `alike`.

    Returns:
        The question, "" where none is alike.
    """
    close = alike(name, choices, 1, likeness)
    return f"Did you mean {mark}{close[0]}{mark}?" if close else ""


def require_one_of(argument: str, value: str, choices: Sequence[str], where: str = "") -> None:
    """Refuse a name that is not among the known ones, and ask for the one that may be meant.

    Raises:
        ValueError: `value` is not in `choices`.
    """
    if value in choices:  # a question takes a hundred times as long
        return
    needs = f"be one of {', '.join(sorted(choices))}"
    meant = did_you_mean(str(value), choices)
    raise ValueError(message(argument, needs, repr(value), where, meant))


def require_multiple(argument: str, value: float | int, step: float | int, where: str = "") -> int:
    """Return how many steps make up `value`.

    Raises:
        ValueError: `value` is not a whole number of steps.
    """
    require_positive(argument, value, where)
    require(step > 0, argument, "be a multiple of a positive step", f"a step of {step}", where)
    steps = round(value / step)
    whole = steps >= 1 and math.isclose(steps * step, value, rel_tol=1e-6)
    require(
        whole,
        argument,
        f"be a multiple of {step}",
        value,
        where,
        f"Take {max(steps, 1) * step:g}, for example.",
    )
    return steps
