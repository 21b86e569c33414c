"""Whole scenes of a converted cache."""

import numpy as np
import pytest

from diffstack_mmv.data import ConvertedCache, RecordedScenes
from tests.data.conftest import crowd, write_cache


def test_everybody_is_where_the_cache_says(source):
    scenes = RecordedScenes(source)
    assert scenes.duration_s("val") == {"scene_5": pytest.approx(8.9)}
    scene = scenes.read("scene_5")
    assert scene.dt_s == 0.1
    for number, agent in enumerate(crowd()):
        rows = slice(agent.first, agent.first + agent.rows)
        place = scene.tracks.motion.position[number, rows].numpy()
        assert np.allclose(place, agent.table()[["x", "y"]], atol=1e-4)
        assert scene.tracks.valid[number].sum() == agent.rows
        assert int(scene.tracks.mode[number]) == agent.mode
    assert scene.tracks.extent[0].tolist() == pytest.approx([1.8, 0.6])


def test_a_split_without_scenes_is_refused(source):
    with pytest.raises(ValueError, match="`phase` must be one of test, train, val"):
        RecordedScenes(source).duration_s("night")


@pytest.mark.parametrize("file", ["scene_metadata*.dill", "agent_data*.feather"])
@pytest.mark.parametrize("lost", [True, False])
def test_a_lost_or_damaged_file_is_told_with_its_remedy(tmp_path, file, lost):
    write_cache(tmp_path, {"scene": ("val", crowd())})
    path = next(tmp_path.glob(f"toy/scene/{file}"))
    if lost:
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(ValueError, match=r"hold the files of its conversion.*scripts/convert\.py"):
        RecordedScenes(ConvertedCache("toy", str(tmp_path))).read("scene")
