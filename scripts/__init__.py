"""The command lines; each file is one command, and `--help` explains it."""

import sys

from dmmv_conventions.extras import MissingExtraError, needs

try:
    with needs("stack", "the command lines"):
        import hydra  # noqa: F401
except MissingExtraError as missing:
    sys.exit(str(missing))
