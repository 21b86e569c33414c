"""Failures of a command, told in one line each, with an exit status to trust."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import NoReturn

from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException, HydraException
from hydra.types import RunMode
from omegaconf.errors import OmegaConfBaseException

from diffstack_mmv.commands.endings import ToldToEndError
from diffstack_mmv.commands.override_errors import (
    one_line,
    told,
    told_of_access,
    told_of_disk,
    told_of_folder,
)
from dmmv_conventions.disk import disk_is_full
from dmmv_conventions.extras import MissingExtraError
from dmmv_conventions.locks import is_first_process

EXPECTED = (
    ValueError,
    TypeError,
    LookupError,
    OSError,
    MissingExtraError,
    HydraException,
    OmegaConfBaseException,
)
FULL_ERROR = "HYDRA_FULL_ERROR"
"""Environment variable that asks for the traceback of a failure (1)."""
_RAISING = ContextVar("raising", default=False)
"""Whether Hydra was asked for its errors by us, not by who runs the command."""
_INTERRUPTED = 130
"""Exit status of a command that Ctrl-C has ended, by the convention of shells."""


class CommandError(CompactHydraException):
    """A failure that is told in one line; the status of the command is 1."""


@contextmanager
def composition_told(folder: Path, config_name: str) -> Iterator[None]:
    """Have Hydra raise what it would print in many lines, and tell it in one.

    Raises:
        SystemExit: The command failed, or was interrupted, or nobody reads what it prints any more.
    """
    if os.environ.get(FULL_ERROR) == "1":
        yield
        return
    arguments, before = list(sys.argv[1:]), _RAISING.set(True)
    os.environ[FULL_ERROR] = "1"
    try:
        yield
    except CommandError as error:
        _exit(str(error))
    except (HydraException, OmegaConfBaseException) as error:
        _exit(told(error, arguments, folder, config_name))
    except KeyboardInterrupt:
        sys.stderr.write("Interrupted.\n")
        raise SystemExit(_INTERRUPTED) from None
    except ToldToEndError as ended:
        sys.stderr.write(ended.told)
        raise
    except BrokenPipeError:
        # whoever reads has seen enough, as in `--help | head`; nothing is left to be flushed either
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(1) from None
    except OSError as error:
        # outside of a job Hydra touches the disk for nothing else
        _exit(told_of_folder(error))
    except ValueError as error:
        # what a job raises is told within it: this is of options that exclude each other, of a
        # group without a name, or of a log that cannot be written
        if isinstance(error.__cause__, OSError):
            _exit(told_of_folder(error.__cause__))
        _exit(told(error, arguments, folder, config_name))
    finally:
        del os.environ[FULL_ERROR]
        _RAISING.reset(before)


@contextmanager
def failures_told() -> Iterator[None]:
    """Tell the failure of a job in one line.

    A job of a sweep raises it: the others go on, and the command ends with it. A job that was told
    to end takes the sweep with it: that was meant for all of it. Within the job the environment is
    that of the user, since it may start further processes.

    Raises:
        SystemExit: The only job of the command failed, or one was told to end.
        CommandError: A job of a sweep failed.
    """
    raising = _RAISING.get()
    if raising:
        del os.environ[FULL_ERROR]
    try:
        yield
    except InterruptedError as told_to_end:
        if not is_first_process():
            # all end together, and the first tells it: it would be killed over a failed one
            raise SystemExit(0) from None
        _exit(_told(told_to_end))
    except EXPECTED as error:
        if raising and HydraConfig.get().mode is RunMode.RUN:
            _exit(_told(error))
        raise CommandError(_told(error)) from error
    finally:
        if raising:
            os.environ[FULL_ERROR] = "1"


def _exit(line: str) -> NoReturn:
    sys.stderr.write(f"{line}\n")
    raise SystemExit(1)


def _told(error: BaseException) -> str:
    """The message of the first cause, in one line.

    What a constructor refused, not that Hydra could not call it. What names the argument at fault
    says enough without the kind of the error.
    """
    while isinstance(error, HydraException) and error.__cause__ is not None:
        error = error.__cause__
    out = HydraConfig.get().runtime.output_dir
    if isinstance(error, OSError) and disk_is_full(error):
        return told_of_disk(error, out)
    if isinstance(error, PermissionError):
        return told_of_access(error, out)
    line = one_line(str(error))
    return line if line.startswith("`") else f"{type(error).__name__}: {line}"
