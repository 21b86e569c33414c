"""A result tells which code has made it."""

import pytest

from dmmv_conventions.versions import code_version, sources_hash


@pytest.mark.parametrize(
    ("changed", "counts"),
    [
        ("diffstack_mmv/dynamics/kbm.py", True),
        ("diffstack_mmv/control/native/solver.hpp", True),
        ("dmmv_conventions/threads.hpp", True),
        ("diffstack_mmv/reporting/html/page.css", False),
        ("scripts/navigate.py", False),
    ],
)
def test_the_hash_is_of_what_runs_libraries_included(tmp_path, changed, counts):
    for name in ("diffstack_mmv/core.py", changed):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("first")
    before = sources_hash(tmp_path)
    (tmp_path / changed).write_text("second")
    assert (sources_hash(tmp_path) != before) is counts


def test_the_version_is_that_of_the_package_with_its_sources():
    version, _, digest = code_version().partition("+")
    assert version
    assert len(digest) == 16
