"""The decorator that the import hook of jaxtyping puts on every function of the package.

It stands in for jaxtyping's own, which checks the arguments twice, decorates the functions inside
of functions anew at every call, and cannot be traced by `torch.compile`: the tests of planning
would take four times as long instead of 1.6 times. Less is checked in four places: functions
inside of functions, a return value of type `Self`, a whole number where a `float` is asked for, and
what a test calls more than `CALLS` times: a loop over steps asks the same again and again, which
took half the time of the suite.
"""

import collections
import dataclasses
import functools
import inspect
import os
from typing import Self

import jaxtyping
import torch
from beartype import BeartypeConf
from beartype.roar import BeartypeCallHintParamViolation

SHAPES = jaxtyping.jaxtyped("context")
CALLS = int(os.environ.get("CHECKED_CALLS", "10"))
"""So many calls of each function are checked in each test; `make test-all` checks them all."""
_called: collections.Counter = collections.Counter()


class ArgumentError(BeartypeCallHintParamViolation, TypeError):
    """As Python's own: what is foretold of settings waits where a value is still to be built."""


NUMBERS = BeartypeConf(
    is_pep484_tower=True,  # a whole number may stand for a `float`, as in PEP 484
    violation_param_type=ArgumentError,
)


def checked(function=None, *, typechecker):
    """Check arguments and return value, the axes by name; while compiling, nothing.

    Args:
        function: Function or class; of a class only the constructor of a dataclass is checked.
            Functions inside of functions stay as they are.
        typechecker: Decorator of beartype.
    """
    if function is None:
        return functools.partial(checked, typechecker=typechecker)
    if inspect.isclass(function):
        if dataclasses.is_dataclass(function) and "__init__" in vars(function):
            function.__init__ = checked(function.__init__, typechecker=typechecker)
        return function
    if "<locals>" in function.__qualname__ or not function.__annotations__:
        return function
    if function.__annotations__.get("return") is Self:
        del function.__annotations__["return"]  # beartype knows it in whole classes only
    checking = typechecker(function, conf=NUMBERS)

    @functools.wraps(function)
    def call(*arguments, **named):
        if torch.compiler.is_compiling() or jaxtyping.config.jaxtyping_disable:
            return function(*arguments, **named)
        if _called[function] >= CALLS:
            return function(*arguments, **named)
        _called[function] += 1
        with SHAPES:
            return checking(*arguments, **named)

    return call


def begin_test():
    """Check the first calls of every function anew."""
    _called.clear()


def install():
    """Put this decorator in the place of jaxtyping's; before the package is imported."""
    jaxtyping.jaxtyped = checked
