"""Whatever data set is converted: its recordings are the same wherever they lie."""

import shutil
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

import diffstack_mmv.commands.cli  # noqa: F401  registers the resolvers
from tests.data_converters.synthetic import WRITERS

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SETS = {path.stem for path in (CONFIGS / "data").glob("*.yaml")} - {"converted", "trajdata"}


def sources(name, root, out):
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        given = [f"data={name}", f"data.root={root}", f"data.cache={out}", f"out={out}"]
        return instantiate(compose("convert", given).data.recordings).scenes()


@pytest.mark.parametrize("name", sorted(SETS))
def test_recordings_that_were_moved_are_the_same(name, tmp_path):
    WRITERS[name](tmp_path / "here")
    before = sources(name, tmp_path / "here", tmp_path / "out")
    shutil.move(tmp_path / "here", tmp_path / "there")
    assert sources(name, tmp_path / "there", tmp_path / "out") == before
