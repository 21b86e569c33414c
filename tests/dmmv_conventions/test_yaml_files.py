"""YAML files that anyone may have written."""

import pytest
from omegaconf import OmegaConf

from diffstack_mmv.vehicles import load_vehicle
from dmmv_conventions.yaml_files import load_plain, read_mapping, to_yaml

LAUGHS = "a: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"b{n}: &a{n + 1} [{', '.join([f'*a{n}'] * 10)}]\n" for n in range(9)
)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a: [1", "`vehicle` must be a YAML file"),
        ("[1, 2]", "`vehicle` must be a mapping"),
        ("", "`vehicle` must be a mapping"),
        ("a: ${b}", "`vehicle` must be a YAML file"),
        ("a: " + "[" * 5000 + "]" * 5000, "`vehicle` must be a YAML file"),
        (LAUGHS, "`vehicle` must hold at most 100000 values"),
        ("a: 1\na: 2", "found the key a twice"),
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


VALUES = [
    "1e-3", "1E3", "1.e3", ".5e2", "-2e+4", "1_000e3", "1.0", "1", "on", "0x1f", "1e", "2026-11-22",
    "e3", "1.2.3", "12:30", "-.inf", "~",
]  # fmt: skip


@pytest.mark.parametrize("value", VALUES)
def test_values_are_read_as_by_hydra(value):
    read, expected = load_plain(f"a: {value}")["a"], OmegaConf.create(f"a: {value}").a
    assert (read, type(read)) == (expected, type(expected))


@pytest.mark.parametrize("value", [*VALUES, 1e-5, 1, True, None, "ä: {}", "${b}", [1, "x"]])
def test_values_are_written_so_that_they_are_read_back(value):
    assert load_plain(to_yaml({"a": {"b": value}})) == {"a": {"b": value}}
