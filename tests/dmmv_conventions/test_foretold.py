"""Settings are refused without importing what they are for, by the rules of its constructor."""

import sys

import pytest

from dmmv_conventions import definitions
from dmmv_conventions.foretold import require_foretold

SOURCE = '''
from dataclasses import dataclass

import no_such_package
from dmmv_conventions.checks import require, require_at_least, require_positive, require_whole

LEAST = 2


class Part:
    def __init__(self, size, *, rate=1.0, weights=None, inner=None, scale=None, count=1) -> None:
        super().__init__()
        if size == 0:
            raise RuntimeError("nobody runs what does more than check")
        require_at_least("size", size, LEAST)
        require_whole("count", count)
        require_positive("rate", rate, remedy="Take 1.0.")
        for name, weight in (weights or {}).items():
            require_positive(f"weights.{name}", weight)
        if inner is not None:
            require_positive("inner", inner)
        scale = no_such_package.scaled(scale)
        require_positive("scale", scale)
        least = LEAST + 1
        fits = size != least
        require(fits, "size", f"differ from {least}", size)
        if rate == 7.0:
            return
        require(rate < 5.0, "rate", "be below 5", rate)


class Derived(Part):
    def __init__(self, number, *rest) -> None:
        super().__init__(2 * number, *rest, rate=number.unknown, weights={"one": number})


class Heir(Part):
    """Judged by its base alone."""


@dataclass
class Fields:
    size: int
    rate: float = 1.0

    def __post_init__(self) -> None:
        require_at_least("size", self.size, 1)
        require_positive("rate", self.rate)


@dataclass
class MoreFields(Fields):
    depth: int = 3


def built(rate=1.0):
    require_positive("rate", rate)
    return no_such_package.build(rate)
'''


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A package of parts which cannot be imported here, and which re-exports some of them."""
    folder = tmp_path_factory.mktemp("sources")
    inner = folder / "foretold_parts"
    inner.mkdir()
    (inner / "parts.py").write_text(SOURCE)
    (inner / "__init__.py").write_text(
        "from typing import TYPE_CHECKING\n\nif TYPE_CHECKING:\n"
        "    from foretold_parts.parts import Derived, Fields, Heir, MoreFields, Part, built\n"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        patch.setattr(definitions, "PROJECT", ("foretold_parts",))
        yield "foretold_parts"
    assert "foretold_parts" not in sys.modules


def node(package, name, **settings):
    return {"_target_": f"{package}.{name}", **settings}


@pytest.mark.parametrize(
    ("name", "settings", "told"),
    [
        ("Part", {"size": 1}, "`size` must be at least 2, but got 1"),
        ("Part", {"size": 3}, "`size` must differ from 3, but got 3"),
        ("Part", {"size": 2, "rate": 0}, "`rate` must be positive, but got 0. Take 1.0."),
        ("Part", {"size": 2, "weights": {"a": -1}}, "`weights.a` must be positive, but got -1"),
        ("Part", {"size": 2, "inner": -1}, "`inner` must be positive, but got -1"),
        ("parts.Part", {"size": 1}, "`size` must be at least 2, but got 1"),
        ("Heir", {"size": 1}, "`size` must be at least 2, but got 1"),
        ("Derived", {"number": 0.5}, "`size` must be at least 2, but got 1.0"),
        ("Derived", {"number": -1}, "`size` must be at least 2, but got -2"),
        ("Fields", {"size": 0}, "`size` must be at least 1, but got 0"),
        ("Fields", {"size": 1, "rate": -1}, "`rate` must be positive, but got -1"),
        ("MoreFields", {"size": 1, "rate": -1}, "`rate` must be positive, but got -1"),
        ("built", {"rate": -1}, "`rate` must be positive, but got -1"),
    ],
)
def test_what_the_constructor_checks_is_refused_wherever_it_stands(package, name, settings, told):
    with pytest.raises(ValueError, match=told.replace(".", r"\.")):
        require_foretold({"deep": [{"er": node(package, name, **settings)}]})


@pytest.mark.parametrize(
    ("size", "told"),
    [("text", "be a number, but got 'text'"), (None, "be at least 2, but got None")],
)
def test_what_is_no_number_is_refused(package, unchecked, size, told):
    with pytest.raises(ValueError, match=f"`size` must {told}"):
        require_foretold({"_target_": "foretold_parts.Part", "size": size})


@pytest.mark.parametrize(
    "content",
    [
        {"_target_": "foretold_parts.Part", "size": 2},
        {"_target_": "foretold_parts.Part", "size": 0, "_partial_": True},
        {"_target_": "foretold_parts.Part", "_args_": [0]},
        # computed by what is not imported
        {"_target_": "foretold_parts.Part", "size": 2, "scale": -1},
        # to be built first
        {
            "_target_": "foretold_parts.Part",
            "size": {"_target_": "a.b"},
            "inner": {"_target_": "a"},
            "count": {"_target_": "a"},
        },
        # behind a return
        {"_target_": "foretold_parts.Part", "size": 2, "rate": 6},
        {"_target_": "foretold_parts.Absent", "size": 0},
        {"_target_": "foretold_parts.parts.LEAST", "size": 0},
        {"_target_": "elsewhere.Part", "size": 0},
        {"_target_": "Part", "size": 0},
        {"size": 0},
        [],
    ],
)
def test_what_cannot_be_told_yet_is_left_to_the_part(package, unchecked, content):
    require_foretold(content)
