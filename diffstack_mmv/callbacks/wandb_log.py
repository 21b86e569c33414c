"""The logger of W&B, without settings that W&B itself warns of."""

from typing import Any

from pytorch_lightning.loggers import WandbLogger


class QuietWandbLogger(WandbLogger):
    """As Lightning's, without the lines of warning that every run of it would begin with.

    Lightning always sets `anonymous`, which has no effect any more, and `resume`, which has none
    offline.

    Args:
        settings: As for Lightning's logger.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        vain = ("anonymous", "resume") if self._offline else ("anonymous",)
        for name in vain:
            self._wandb_init.pop(name, None)
