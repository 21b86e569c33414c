"""YAML files that anyone may have written."""

import pytest

from diffstack_mmv.vehicles import load_vehicle
from dmmv_conventions.yaml_files import read_mapping

LAUGHS = "a: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"b{n}: &a{n + 1} [{', '.join([f'*a{n}'] * 10)}]\n" for n in range(9)
)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a: [1", "`vehicle` must be a YAML file"),
        ("[1, 2]", "`vehicle` must be a mapping"),
        ("a: ${b}", "`vehicle` must be a YAML file"),
        ("a: " + "[" * 5000 + "]" * 5000, "`vehicle` must be a YAML file"),
        (LAUGHS, "`vehicle` must hold at most 100000 values"),
        ("a: &a [*a]", "`vehicle` must hold at most 100000 values"),
        ("a: !!python/object/apply:os.system [ls]", "`vehicle` must be a YAML file"),
        ("a: {b: {_target_: os.system}}", "'os.system' at a.b in"),
        ("a: {_target_: diffstack_mmv.dynamics.DiffKBM}", "DiffKBM' at a in"),
    ],
)
def test_a_bad_file_is_refused_in_one_message(text, told, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    for read in (lambda: read_mapping(file, "vehicle"), lambda: load_vehicle(file)):
        with pytest.raises(ValueError, match="`") as raised:
            read()
        assert told in str(raised.value)


def test_values_may_refer_to_each_other(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("a: 3\nb: ${a}\nc: &c [1]\nd: *c\n")
    assert read_mapping(file, "vehicle") == {"a": 3, "b": 3, "c": [1], "d": [1]}
