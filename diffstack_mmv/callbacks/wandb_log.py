"""The logger of W&B: a run of its own for every training, without vain warnings."""

from typing import Any

from pytorch_lightning.loggers import WandbLogger


class QuietWandbLogger(WandbLogger):
    """As Lightning's, but its run ends with the training and does not begin with warnings.

    Lightning leaves the run open: the next training of the process, a job of a multirun, would be
    logged to it as well, and all that the process writes. It also always sets `anonymous`, which
    has no effect any more, and `resume`, which has none offline.

    Args:
        settings: As for Lightning's logger.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        vain = ("anonymous", "resume") if self._offline else ("anonymous",)
        for name in vain:
            self._wandb_init.pop(name, None)

    def finalize(self, status: str) -> None:
        """Close the run; one of a training that failed is marked as failed."""
        super().finalize(status)
        if self._experiment is not None:
            self._experiment.finish(exit_code=0 if status == "success" else 1)
            self._experiment = None
