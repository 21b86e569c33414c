"""Parts of a training that do not go together."""

import pytest

from diffstack_mmv.commands.training_checks import require_places

SITE = {"site": {"_target_": "diffstack_mmv.prediction.trajectron.Site"}}


def changed(kind, **more):
    return {"_target_": f"diffstack_mmv.data.{kind}", **more}


def test_a_site_that_no_sample_is_at_is_refused_by_the_command(refusal, tmp_path):
    """Its code would be what the random start of its weights makes of a place."""
    words = "predictor=trajectron_site", "augmentation@data.module.augmentation=scaled"
    told = refusal("train", *words, f"data.cache={tmp_path}", f"out={tmp_path / 'out'}")
    place = "data.module.augmentation.augmentations[1].probability"
    assert f"`{place}` must be below 1 beside a predictor with a site" in told
    assert "but got 1.0 for SpeedScale. Add ++data.module.augmentation.augmentations.1." in told
    mended = "++data.module.augmentation.augmentations.1.probability=0.5"
    told = refusal("train", *words, mended, f"data.cache={tmp_path}", f"out={tmp_path / 'out'}")
    assert "`cache` must hold a finished conversion" in told


@pytest.mark.parametrize(
    ("predictor", "augmentation"),
    [
        (SITE, None),
        (SITE, changed("Mirror")),
        (SITE, {"augmentations": [changed("Mirror"), changed("SpeedScale", probability=0.5)]}),
        (SITE, changed("RecordingNoise", probability=1.0)),
        ({"site": None}, changed("SpeedScale")),
        ({}, changed("Mirror", probability=1.0)),
    ],
)
def test_a_site_learns_from_the_samples_that_are_left_as_they_are(predictor, augmentation):
    require_places(predictor, augmentation)


def test_a_site_of_mirrored_samples_alone_is_refused():
    with pytest.raises(ValueError, match="below 1 beside a predictor with a site.* got 1.0 for M"):
        require_places(SITE, changed("Mirror", probability=1.0))
