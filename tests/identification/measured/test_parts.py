"""Finished parts of a study are found again, and only under what they were made of."""

import pytest
import torch

from diffstack_mmv.identification.measured import InstrumentPriors
from diffstack_mmv.identification.measured.instruments import Gaussian
from diffstack_mmv.identification.measured.parts import (
    FinishedParts,
    priors_as_tensor,
    priors_from_tensor,
)


def test_part_is_made_once_for_the_same_data_and_settings(tmp_path):
    made = []

    def make():
        made.append(1)
        return {"values": torch.arange(3.0), "flags": torch.tensor([True, False])}

    parts = FinishedParts(tmp_path)
    for data, settings in ((1.0, "a"), (1.0, "a"), (2.0, "a"), (1.0, "b")):
        part = parts.keyed(torch.tensor(data), settings)("fit", make)
    assert len(made) == 3
    torch.testing.assert_close(part["values"], torch.arange(3.0))
    assert part["flags"].dtype == torch.bool
    assert not list(tmp_path.glob("*.part"))


def test_a_damaged_part_is_made_anew(tmp_path):
    parts = FinishedParts(tmp_path)
    for _ in range(2):
        part = parts("fit", lambda: {"values": torch.arange(3.0)})
        torch.testing.assert_close(part["values"], torch.arange(3.0))
        (file,) = tmp_path.iterdir()
        file.write_bytes(file.read_bytes()[:100])


def test_part_that_fails_leaves_nothing(tmp_path):
    def fails():
        raise ValueError("singular")

    with pytest.raises(ValueError, match="singular"):
        FinishedParts(tmp_path)("fit", fails)
    assert not list(tmp_path.iterdir())


def test_priors_survive_a_tensor():
    priors = InstrumentPriors(delay_s=Gaussian(0.01, 0.02), coasting_share=0.3)
    assert priors_from_tensor(priors_as_tensor(priors)) == priors
