"""Repairs of scenes of trajdata's own data sets, applied whenever a scene is opened."""

import numpy as np
import pandas as pd
from trajdata.augmentation.augmentation import DatasetAugmentation

from diffstack_mmv.checks import require_positive


class HeldHeading(DatasetAugmentation):
    """Hold the heading of an agent while it stands still.

    Several of trajdata's loaders take the heading from the velocity, which has no direction at
    rest. Rows before the first motion of an agent keep theirs: what comes later is not known then.
    """

    def __init__(self, standstill_mps: float = 0.4) -> None:
        """Set the speed in m/s below which a direction of motion is noise.

        Raises:
            ValueError: The speed is not positive.
        """
        require_positive("standstill_mps", standstill_mps)
        self.standstill_mps = standstill_mps

    def apply(self, scene_data_df: pd.DataFrame) -> None:
        """Overwrite the column `heading` (rad) of a scene; rows are sorted by agent and time."""
        moving = np.hypot(scene_data_df["vx"], scene_data_df["vy"]) >= self.standstill_mps
        known = scene_data_df["heading"].where(moving)
        held = known.groupby(level=0).ffill()
        scene_data_df["heading"] = held.fillna(scene_data_df["heading"])


class UpwardY(DatasetAugmentation):
    """Turn the y axis of data in picture coordinates (y downwards) up, so that left is left."""

    def __init__(self) -> None:
        """Nothing to set; the base class refuses to be built."""

    def apply(self, scene_data_df: pd.DataFrame) -> None:
        """Change the signs of y, vy, ay and heading of a scene."""
        for column in ("y", "vy", "ay", "heading"):
            scene_data_df[column] = -scene_data_df[column]
