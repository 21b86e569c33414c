"""Parts that need more than the core of the package: one line where that is not installed."""

from collections.abc import Iterator
from contextlib import contextmanager

from dmmv_conventions.checks import message

OURS = ("dmmv_conventions", "data_converters", "diffstack_mmv", "diffstack_mmv_scripts")


class MissingExtraError(ModuleNotFoundError):
    """A package is not installed that an extra of this project would bring."""


@contextmanager
def needs(extra: str, part: str) -> Iterator[None]:
    """Say of a missing package which extra brings it, around the imports that need it.

    Args:
        extra: Name of the extra.
        part: What needs it.

    Raises:
        MissingExtraError: A package of others is not installed.
    """
    try:
        yield
    except MissingExtraError:
        raise
    except ModuleNotFoundError as missing:
        package = (missing.name or "").partition(".")[0]
        if package in OURS:
            raise
        remedy = f"Run: pip install 'diffstack_mmv[{extra}]', in a checkout: '.[{extra}]'"
        wanted = f"be installed for {part}"
        raise MissingExtraError(
            message(package, wanted, "nothing of that name", "", remedy), name=missing.name
        ) from missing


@contextmanager
def needs_to_run(extra: str, part: str) -> Iterator[None]:
    """The same for a command: it ends with that line.

    Args:
        extra: Name of the extra.
        part: What needs it.

    Raises:
        SystemExit: A package of others is not installed.
    """
    try:
        with needs(extra, part):
            yield
    except MissingExtraError as missing:
        raise SystemExit(str(missing)) from missing
