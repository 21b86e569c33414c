"""Arguments that a part does not have are refused without importing it."""

import subprocess
import sys

import pytest

from dmmv_conventions import definitions
from dmmv_conventions.arguments import require_arguments

SOURCE = """
from dataclasses import dataclass
from typing import NamedTuple

import no_such_package as elsewhere
import pytorch_lightning as pl
from torch import nn


class Part:
    def __init__(self, size, *, rate=1.0) -> None: ...


class Heir(Part): ...


class Open(Part):
    def __init__(self, size, **others) -> None: ...


class Made(Part):
    def __new__(cls, *given, **named): ...


class Layer(nn.Module): ...


class Stranger(elsewhere.Part): ...


class Stopping(pl.callbacks.EarlyStopping): ...


class Row(NamedTuple):
    width: int


@dataclass(frozen=True)
class Fields:
    size: int


@dataclass
class MoreFields(Fields):
    depth: int = 3


def built(rate): ...
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A package that cannot be imported."""
    folder = tmp_path_factory.mktemp("sources")
    (folder / "argument_parts").mkdir()
    (folder / "argument_parts" / "__init__.py").write_text(SOURCE)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        patch.setattr(definitions, "PROJECT", ("argument_parts",))
        yield "argument_parts"
    assert "argument_parts" not in sys.modules


TAKEN = {
    "Part": {"size": 1, "rate": 2},
    "Heir": {"size": 1},
    "Row": {"width": 1},
    "Fields": {"size": 1},
    "MoreFields": {"size": 1, "depth": 2},
    "Stopping": {"monitor": "loss", "patience": 3},
    "built": {"rate": 1},
}


@pytest.mark.parametrize("name", TAKEN)
def test_an_argument_too_many_is_named_with_its_place(package, name):
    part = {"_target_": f"{package}.{name}", "_partial_": True, **TAKEN[name]}
    require_arguments({"deep": [{"er": part}]})
    told = rf"`deep\[0\].er.wings` must be an argument of {package}.{name}, but got 2"
    with pytest.raises(ValueError, match=told):
        require_arguments({"deep": [{"er": {**part, "wings": 2}}]})


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (["+deep.wings=2"], "Remove it."),
        (["+deep={wings: 2}"], "Remove it."),
        (["deep=other"], "A file of the configuration gives it: choose another `deep`."),
    ],
)
def test_an_argument_that_nobody_gave_is_not_to_be_removed(package, words, remedy):
    part = {"_target_": f"{package}.Row", "width": 1, "wings": 2}
    with pytest.raises(ValueError, match=f"{remedy}$"):
        require_arguments({"deep": {"er": part}}, words)


@pytest.mark.parametrize("name", ["Open", "Made", "Layer", "Stranger", "Absent", "Part.of"])
def test_what_may_take_anything_is_left_to_itself(package, name, unchecked):
    require_arguments({"_target_": f"{package}.{name}", "wings": 2})


def test_the_first_of_two_places_is_told_and_a_similar_name_proposed(package):
    part = {"_target_": f"{package}.Part", "size": 1, "rat": 2}
    with pytest.raises(ValueError, match=r"`part\.rat` .* Did you mean `rate`\?"):
        require_arguments({"whole": {"_target_": "x.Y", "part": part}, "part": part})


def test_nothing_is_imported_for_it():
    code = (
        "from dmmv_conventions.arguments import require_arguments as r\n"
        "for name in ('pytorch_lightning.Trainer', 'torch.optim.AdamW'):\n"
        "    try: r({'_target_': name, 'wings': 2})\n"
        "    except ValueError as error: print(error)\n"
        "import sys; print(sorted({'torch', 'pytorch_lightning'} & set(sys.modules)))"
    )
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    assert [line.split("of ")[1].split(",")[0] for line in said[:2]] == [
        "pytorch_lightning.Trainer",
        "torch.optim.AdamW",
    ]
    assert said[2] == "[]"
