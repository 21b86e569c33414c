"""Values of another type than that of an argument are refused without importing the part."""

import ast

import pytest

from dmmv_conventions.annotations import fits, require_types
from dmmv_conventions.definitions import Annotation

SOURCE = ast.parse(
    """
from lightning_fabric.plugins.precision.precision import _PRECISION_INPUT_INT as Bits

Kind = Literal["step", "epoch"]
"""
)


def annotated(text):
    return Annotation(ast.parse(text, mode="eval").body, SOURCE)


FITTING = [
    ("int", 1),
    ("float", 1),
    ("float", 1.5),
    ("bool", False),
    ("str", "text"),
    ("Optional[int]", None),
    ("int | None", None),
    ("Union[int, str]", "text"),
    ("t.Optional[str]", "text"),
    ("list[int]", [1, 2]),
    ("tuple[float, float]", [0.9, 0.99]),
    ("dict[str, int]", {"a": 1}),
    ("Literal['warn', 1]", "warn"),
    ("Optional[Kind]", "epoch"),
    ("'int'", 1),
    ("Bits", 32),
]
UNFITTING = [
    ("int", 1.5),
    ("int", True),
    ("int", "text"),
    ("int", None),
    ("float", "text"),
    ("float", False),
    ("bool", "text"),
    ("bool", 1),
    ("str", 1),
    ("Optional[int]", "text"),
    ("Union[int, str]", [1]),
    ("list[int]", ["text"]),
    ("list[int]", 1),
    ("dict[str, int]", [1]),
    ("Literal['warn', 1]", "foo"),
    ("Literal[1]", True),
    ("Optional[Kind]", "year"),
    ("'int'", "text"),
    ("Bits", 31),
]
UNKNOWN = [
    ("Logger", "text"),
    ("Optional[Logger]", 1),
    ("int | Tensor", "text"),
    ("list[Logger]", [1]),
    ("int", {"_target_": "some.Part"}),
]


@pytest.mark.parametrize(("annotation", "value"), FITTING)
def test_a_value_of_the_type_fits(annotation, value):
    assert fits(value, annotated(annotation)) is True


@pytest.mark.parametrize(("annotation", "value"), UNFITTING)
def test_a_value_of_another_type_does_not(annotation, value):
    assert fits(value, annotated(annotation)) is False


@pytest.mark.parametrize(("annotation", "value"), UNKNOWN)
def test_what_only_the_part_can_judge_is_left_to_it(annotation, value):
    assert fits(value, annotated(annotation)) is None


@pytest.mark.parametrize(
    ("target", "given", "told"),
    [
        (
            "pytorch_lightning.Trainer",
            {"min_epochs": "few"},
            "`part.min_epochs` must be a whole number or null, but got 'few' in the configuration",
        ),
        (  # by what its base class of Lightning tells
            "diffstack_mmv.callbacks.EarlyStopping",
            {"patience": "much"},
            "`part.patience` must be a whole number",
        ),
    ],
)
def test_the_message_names_the_key_and_what_it_may_be(target, given, told):
    with pytest.raises(ValueError, match=told):
        require_types({"part": {"_target_": target, **given}})


def test_what_is_given_rightly_passes():
    optimizer = {"_target_": "torch.optim.AdamW", "lr": 1, "betas": [0.9, 0.99], "fused": None}
    require_types({"optimizer": optimizer})


@pytest.mark.parametrize(
    ("target", "name"),
    [
        ("prediction.Trajectron", "components"),
        ("control.ILQR", "max_iterations"),
        ("control.constrained.ConstrainedILQR", "persistent"),
        ("prediction.Sizes", "history"),
    ],
)
def test_a_list_in_place_of_one_value_of_ours_is_named_by_its_whole_key(target, name):
    part = {"_target_": f"diffstack_mmv.{target}", "_partial_": True, name: [1]}
    with pytest.raises(ValueError, match=rf"`the.part.{name}` must be .*, but got \[1\]"):
        require_types({"the": {"part": part}})


def test_the_key_of_the_group_is_named_rather_than_that_of_a_part_it_is_handed_to():
    solver = {"_target_": "diffstack_mmv.control.ILQR", "max_iterations": [1]}
    with pytest.raises(ValueError, match="`solver.max_iterations` must be"):
        require_types({"planner": {"solver": solver}, "solver": solver})


def test_what_else_our_parts_are_given_they_judge_themselves():
    require_types({"_target_": "diffstack_mmv.control.ILQR", "max_iterations": "many"})
