"""Files of a configuration group, read without Hydra as it would compose them."""

import pytest
from omegaconf import OmegaConf

from dmmv_conventions.config_files import factory, settings_of


def test_a_setting_that_only_a_command_line_knows_is_refused(tmp_path):
    (tmp_path / "mine.yaml").write_text("_target_: builtins.dict\nsubsteps: ${substeps}\n")
    told = r"`substeps` must be a plain value, but got '\$\{substeps\}'"
    with pytest.raises(ValueError, match=told):
        factory(settings_of("mine", tmp_path))


def test_interpolations_within_a_file_are_followed_as_by_omegaconf(tmp_path):
    text = "a: {b: 1, c: '${.b}', d: {e: '${..c}', f: ['${....a.d.e}']}}\ng: '${.a.d}'\n"
    (tmp_path / "mine.yaml").write_text(text)
    resolved = OmegaConf.to_container(OmegaConf.create(text), resolve=True)
    assert settings_of("mine", tmp_path) == resolved
    (tmp_path / "mine.yaml").write_text("a: {b: '${..c}'}")
    with pytest.raises(ValueError, match=r"`settings` must hold .*, but got '\$\{\.\.c\}'"):
        settings_of("mine", tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        "a: '${.a}'",
        "a: '${.b}'\nb: '${.a}'",
        "a: {b: '${..a}'}",
        "a: {b: '${..c.d}'}\nc: {d: ['${...a}']}",
    ],
)
def test_an_interpolation_that_leads_back_to_itself_is_refused(tmp_path, text):
    (tmp_path / "mine.yaml").write_text(text)
    told = r"`settings` must hold no interpolation that leads back to itself, but got '\$\{\.+"
    with pytest.raises(ValueError, match=told):
        settings_of("mine", tmp_path)


def test_the_same_interpolation_may_be_met_again_elsewhere(tmp_path):
    text = "a: {x: '${.y}', y: '${..b.x}'}\nb: {x: '${.y}', y: 1}\nc: '${.a}'\n"
    (tmp_path / "mine.yaml").write_text(text)
    found = settings_of("mine", tmp_path)
    assert found == {"a": {"x": 1, "y": 1}, "b": {"x": 1, "y": 1}, "c": {"x": 1, "y": 1}}
