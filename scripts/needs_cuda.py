"""Exit with status 0 where the installed torch needs no packages for CUDA, else with 1."""

import argparse
import sys
from importlib.metadata import version

if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    raise SystemExit(int(sys.platform == "linux" and "+cpu" not in version("torch")))
