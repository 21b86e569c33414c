"""What is known beforehand of single windows: instruments, freewheel and course."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.identification.measured.instruments import InstrumentPriors

UNKNOWN_RAD = 100.0
"""Prior deviation of a course of which nothing is known."""


class FreewheelGiven(NamedTuple):
    """Prior of the freewheel of each window: mean and deviation of excess and loss of speed."""

    coasts: Float[Tensor, "w 2 2"]
    drives: Float[Tensor, "w 2 2"]
    share: Float[Tensor, " w"]  # of the windows that coast

    @classmethod
    def of(cls, priors: InstrumentPriors, count: int) -> "FreewheelGiven":
        """The same priors for so many windows."""
        share = torch.full((count,), priors.coasting_share, dtype=torch.float64)
        coasts, drives = (torch.stack(priors.freewheel(it)) for it in (True, False))
        return cls(coasts.expand(count, 2, 2), drives.expand(count, 2, 2), share)

    def where(self, coasting: Bool[Tensor, " w"]) -> tuple[Tensor, Tensor]:
        """Means and deviations (w 2) for windows that coast or do not."""
        chosen = torch.where(coasting.view(-1, 1, 1), self.coasts, self.drives)
        mean, std = chosen.unbind(1)
        return mean.clone(), std


class CourseGiven(NamedTuple):
    """What is known of the course at the start of each window, in rad."""

    mean: Float[Tensor, " w"]
    std: Float[Tensor, " w"]

    @classmethod
    def unknown(cls, count: int) -> "CourseGiven":
        """Nothing."""
        none = torch.zeros(count, dtype=torch.float64)
        return cls(none, torch.full_like(none, UNKNOWN_RAD))


class InstrumentsGiven(NamedTuple):
    """Gaussian prior of the instruments of each window, of its freewheel and its course."""

    mean: Float[Tensor, "w 4"]
    precision: Float[Tensor, "w 4 4"]
    freewheel: FreewheelGiven
    course: CourseGiven

    @classmethod
    def of(cls, priors: InstrumentPriors, count: int) -> "InstrumentsGiven":
        """The same priors for so many windows."""
        mean, std = priors.recording()
        precision = std.pow(-2).diag().expand(count, -1, -1)
        own = FreewheelGiven.of(priors, count), CourseGiven.unknown(count)
        return cls(mean.expand(count, -1), precision, *own)

    @classmethod
    def by_fold(
        cls, priors: Sequence[InstrumentPriors], fold: Int[Tensor, " w"]
    ) -> "InstrumentsGiven":
        """Each window under the priors of its fold."""
        each = [cls.of(one, 1) for one in priors]
        mean, precision = (
            torch.cat(rows)[fold] for rows in zip(*(e[:2] for e in each), strict=True)
        )
        columns = zip(*(one.freewheel for one in each), strict=True)
        freewheel = FreewheelGiven(*(torch.cat(rows)[fold] for rows in columns))
        return cls(mean, precision, freewheel, CourseGiven.unknown(len(fold)))

    def select(self, index: Tensor) -> "InstrumentsGiven":
        """Those of some windows, by their numbers or a mask of shape (w,)."""
        freewheel = FreewheelGiven(*(part[index] for part in self.freewheel))
        course = CourseGiven(*(part[index] for part in self.course))
        return InstrumentsGiven(self.mean[index], self.precision[index], freewheel, course)
