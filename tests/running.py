"""Commands of `scripts/`, run without a process of their own."""

import runpy
import sys
from pathlib import Path

import pytest
from hydra.core.global_hydra import GlobalHydra

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"


def run_here(script, *arguments):
    """Run a command of scripts/ as users do, but in this process; its exit status."""
    GlobalHydra.instance().clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [f"{script}.py", *map(str, arguments)])
        try:
            runpy.run_path(str(SCRIPTS / f"{script}.py"), run_name="__main__")
        except SystemExit as end:
            return end.code or 0
        finally:
            GlobalHydra.instance().clear()
    return 0
