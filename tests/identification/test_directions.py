"""The parts of identification import each other in one direction."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "diffstack_mmv" / "identification"
ORDER = ("tracks", "shooting", "inference", "report", "measured")
FILES = sorted(path.relative_to(PACKAGE).as_posix() for path in PACKAGE.glob("*/*.py"))


@pytest.mark.parametrize("file", FILES)
def test_a_part_imports_only_earlier_parts(file):
    tree = ast.parse((PACKAGE / file).read_text(encoding="utf-8"))
    names = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    ours = [
        name.split(".")[2] for name in names if name.startswith("diffstack_mmv.identification.")
    ]
    assert all(ORDER.index(part) <= ORDER.index(Path(file).parts[0]) for part in ours)
    assert "diffstack_mmv.identification" not in names
