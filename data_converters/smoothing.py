"""Smoothers of irregularly sampled series: values, first and second derivatives at any time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left
from dataclasses import asdict, dataclass
from math import ceil
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from data_converters.errors import require

Array = NDArray[np.float64]


SPACINGS = 20
"""Samples that a window counts at most: in any usual recording it then holds enough of them."""


SAME_TIME_S = 1e-6
"""Times that differ by less are equal: seconds since 1970 resolve a quarter of a microsecond."""


CLOSEST_S = 1e-3
"""Of samples closer than this a spline takes one: it would swing through the noise of both."""


class SmoothSeries(NamedTuple):
    """A smoothed series at m times: value, rate in 1/s, curvature in 1/s², each (m, k)."""

    value: Array
    rate: Array
    curvature: Array


def _apart(time_s: Array, spacing_s: float) -> NDArray[np.int64]:
    """Indices of samples of which each is `spacing_s` or more after the one before, the first one.

    Args:
        time_s: (n,) s, rising.
        spacing_s: Time in s.
    """
    times = time_s.tolist()
    index, found = 0, []
    while index < len(times):
        found.append(index)
        index = bisect_left(times, times[index] + spacing_s, lo=index + 1)
    return np.array(found, dtype=np.int64)


@dataclass(frozen=True)
class Smoother(ABC):
    """Values and derivatives of a series that was sampled at any times.

    Attributes:
        samples_needed: Fewest samples of a series.
    """

    samples_needed: ClassVar[int] = 4

    @property
    @abstractmethod
    def lookahead_s(self) -> float:
        """How far into the future, in s, a smoothed value depends on the recording."""

    @property
    def warmup_s(self) -> float:
        """Time after the first sample, in s, before which nothing is put out."""
        return 0.0

    @property
    def noise_smoother(self) -> Smoother:
        """The smoother whose residual is noise, which that of one that lags is not."""
        return self

    def ready_s(self, time_s: Array) -> float:
        """Time in s from which a series with these sample times (n,) s is put out."""
        return float(time_s[0]) + self.warmup_s

    @abstractmethod
    def __call__(self, time_s: Array, values: Array, at_s: Array) -> SmoothSeries:
        """Smooth `values` (n, k) sampled at rising `time_s` (n,) s; result at `at_s` (m,) s."""

    def settings(self) -> dict[str, float | int | str]:
        """The smoother as plain values, for the report and the hash of the settings."""
        return {"name": type(self).__name__, **asdict(self), "lookahead_s": self.lookahead_s}


@dataclass(frozen=True)
class PolynomialSmoother(Smoother):
    """Local polynomials.

    Attributes:
        window_s: Length of the window in s.
        order: Degree of the polynomial; 2 reproduces constant acceleration exactly.

    Raises:
        ConversionError: If the window is not positive or the order is not 1, 2 or 3.
    """

    window_s: float = 0.9
    order: int = 2

    def __post_init__(self) -> None:
        require(self.window_s > 0.0, "window_s", "be positive", self.window_s, "", "Try 0.9.")
        require(self.order in (1, 2, 3), "order", "be 1, 2 or 3", self.order, "", "Use 2.")


@dataclass(frozen=True)
class ZeroPhaseSmoother(PolynomialSmoother):
    """Savitzky-Golay filter on a time-uniform grid: no lag, looks half a window ahead.

    The series is brought to a uniform fine grid by a cubic spline in time and filtered with
    `scipy.signal.savgol_filter`, whose ends are fitted polynomials. Any quadratic series comes back
    exactly, at any sampling; of samples within `CLOSEST_S` the first one counts.

    Attributes:
        grid_s: Spacing of the grid in s, adjusted so that the grid ends with the series.

    Source: window and order were chosen by leaving out every fifth sample of the TH-AB tracks; see
        data_converters/README.md.
    """

    grid_s: float = 0.02

    @property
    def lookahead_s(self) -> float:
        """Half the window, in s."""
        return self.window_s / 2.0

    def __call__(self, time_s: Array, values: Array, at_s: Array) -> SmoothSeries:
        """See `Smoother`; shapes (n,), (n, k), (m,)."""
        apart = _apart(time_s, CLOSEST_S - 1e-9)
        time_s, values = time_s[apart], values[apart]
        count = max(ceil((time_s[-1] - time_s[0]) / self.grid_s) + 1, self.order + 3)
        grid, step = np.linspace(time_s[0], time_s[-1], count, retstep=True)
        uniform = CubicSpline(time_s, values)(grid)
        width = min(round(self.window_s / float(step)) | 1, (count - 1) | 1)
        parts = [
            savgol_filter(uniform, width, self.order, deriv=d, delta=float(step), axis=0)
            for d in range(3)
        ]
        return SmoothSeries(*(CubicSpline(grid, part)(at_s) for part in parts))


@dataclass(frozen=True)
class CausalSmoother(PolynomialSmoother):
    """Least-squares polynomial through the samples of the last window: uses no later sample.

    The value at t is fitted to the samples in (t - window_s, t] only, so it is noisier than the
    zero-phase one. Where samples are sparse the window reaches back to as many as the polynomial
    has coefficients, and one more; of samples within a twentieth of the window only one counts,
    as they cannot tell motion from noise. Nothing is put out before the track has lasted half a
    window.
    """

    window_s: float = 1.2

    @property
    def lookahead_s(self) -> float:
        """Zero."""
        return 0.0

    @property
    def warmup_s(self) -> float:
        """Half the window, in s."""
        return self.window_s / 2.0

    @property
    def noise_smoother(self) -> Smoother:
        """The zero-phase one: in a turn the lag of this one is several times the noise."""
        return ZeroPhaseSmoother()

    def ready_s(self, time_s: Array) -> float:
        """After the warm-up, and not before enough samples for the polynomial; shape (n,)."""
        apart = self._apart(time_s)
        enough = apart[self.order] if len(apart) > self.order else len(time_s) - 1
        return max(super().ready_s(time_s), float(time_s[enough]))

    def __call__(self, time_s: Array, values: Array, at_s: Array) -> SmoothSeries:
        """See `Smoother`; shapes (n,), (n, k), (m,). Times in the warm-up get NaN."""
        last = np.searchsorted(time_s, at_s + SAME_TIME_S, side="right")
        first = np.searchsorted(time_s, at_s - self.window_s + SAME_TIME_S)
        apart = self._apart(time_s)
        counted = np.searchsorted(apart, last)  # samples before `last` that count
        first = np.minimum(first, apart[np.maximum(counted - self.order - 2, 0)])
        usable = at_s >= self.ready_s(time_s) - SAME_TIME_S
        result = np.full((3, len(at_s), values.shape[1]), np.nan)
        for d, part in enumerate(
            self._fit(time_s, values, at_s[usable], first[usable], last[usable])
        ):
            result[d, usable] = part
        return SmoothSeries(*result)

    def _apart(self, time_s: Array) -> NDArray[np.int64]:
        """Indices of the samples that count, each `window_s` / `SPACINGS` after the one before."""
        return _apart(time_s, self.window_s / SPACINGS - SAME_TIME_S)

    def _fit(
        self,
        time_s: Array,
        values: Array,
        at_s: Array,
        first: NDArray[np.int64],
        last: NDArray[np.int64],
    ) -> list[Array]:
        """Value, rate and curvature (m, k) of the polynomial fitted to samples first..last-1."""
        if len(at_s) == 0:
            return []
        index = first[:, None] + np.arange(int((last - first).max()))
        inside = index < last[:, None]
        index = np.minimum(index, len(time_s) - 1)
        lag = (time_s[index] - at_s[:, None]) / self.window_s
        basis = lag[..., None] ** np.arange(self.order + 1) * inside[..., None]
        normal = np.einsum("mni,mnj->mij", basis, basis)
        moment = np.einsum("mni,mnk->mik", basis, values[index])
        coefficient = np.linalg.solve(normal, moment)
        zero = np.zeros_like(coefficient[:, 0])
        curvature = 2.0 * coefficient[:, 2] / self.window_s**2 if self.order > 1 else zero
        return [coefficient[:, 0], coefficient[:, 1] / self.window_s, curvature]


@dataclass(frozen=True)
class Unsmoothed(Smoother):
    """The samples as they are, with backward differences; between samples at constant velocity.

    The velocity at a sample is the step to it divided by its duration, 0 at the first one; the
    acceleration is the change of that velocity, 0 at the first two. This is what the benchmark of
    ETH and UCY asks for: central differences over a track contain the next position.
    """

    samples_needed: ClassVar[int] = 2

    @property
    def lookahead_s(self) -> float:
        """Zero."""
        return 0.0

    def __call__(self, time_s: Array, values: Array, at_s: Array) -> SmoothSeries:
        """See `Smoother`; shapes (n,), (n, k), (m,)."""
        step = np.diff(time_s)[:, None]
        rate = np.vstack([np.zeros((1, values.shape[1])), np.diff(values, axis=0) / step])
        curvature = np.vstack(
            [np.zeros((2, values.shape[1])), np.diff(rate[1:], axis=0) / step[1:]]
        )
        last = np.maximum(np.searchsorted(time_s, at_s + SAME_TIME_S, side="right") - 1, 0)
        since = (at_s - time_s[last])[:, None]
        return SmoothSeries(values[last] + since * rate[last], rate[last], curvature[last])
