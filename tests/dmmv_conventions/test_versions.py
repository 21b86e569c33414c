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
    places = [tmp_path / package for package in ("diffstack_mmv", "dmmv_conventions")]
    before = sources_hash(places)
    (tmp_path / changed).write_text("second")
    assert (sources_hash(places) != before) is counts


@pytest.mark.parametrize("changed", ["mine.py", "ours/model.py"])
def test_packages_of_ones_own_count_where_files_may_name_them(tmp_path, monkeypatch, changed):
    for name in ("mine.py", "ours/__init__.py", "ours/model.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("")
    monkeypatch.syspath_prepend(str(tmp_path))

    def versions():
        for trusted in ("", "mine, ours", "absent"):
            monkeypatch.setenv("DMMV_TRUSTED_PACKAGES", trusted)
            yield code_version.__wrapped__()

    before = list(versions())
    (tmp_path / changed).write_text("GRAVITY = 9.81")
    others = list(versions())
    assert before[0] == before[2] == others[0] == others[2]
    assert len({before[0], before[1], others[1]}) == 3


def test_the_version_is_that_of_the_package_with_its_sources():
    version, _, digest = code_version().partition("+")
    assert version
    assert len(digest) == 16
