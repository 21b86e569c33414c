"""Sample recordings in the format of IMPTC, so that a newcomer needs no download.

They hold no real data, and no result on them counts as evidence.
"""

from data_converters.imptc.sample.generate import (
    SAMPLE_SEQUENCES,
    generate_sample,
    generate_vru_sample,
)

__all__ = ["SAMPLE_SEQUENCES", "generate_sample", "generate_vru_sample"]
