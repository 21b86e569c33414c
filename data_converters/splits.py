"""Which recording goes to which split: dealt by a hash of its name, so that no recording leaks."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from data_converters.errors import require
from dmmv_conventions.cache import SPLITS


@dataclass(frozen=True)
class RecordingSplit:
    """Whole recordings are dealt to train, val and test, in the order of a hash of their names.

    Attributes:
        shares: Share of the recordings, by their size, in train, val and test.
        salt: Changes the order, hence the split.
        given: Split by recording for those that are not to be dealt.

    Raises:
        ConversionError: If the shares are negative or do not add up to 1, or a split is unknown.
    """

    shares: tuple[float, float, float] = (0.70, 0.15, 0.15)
    salt: str = ""
    given: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        fits = min(self.shares) >= 0.0 and abs(sum(self.shares) - 1.0) <= 1e-9
        remedy = "Give for instance (0.7, 0.15, 0.15)."
        require(fits, "shares", "be >= 0 and add up to 1", self.shares, "", remedy)
        fits = set(self.given.values()) <= set(SPLITS)
        require(fits, "given", f"name {SPLITS}", dict(self.given), "", "Correct them.")

    def settings(self) -> dict[str, object]:
        """Plain values that decide the split."""
        return {"shares": list(self.shares), "salt": self.salt, "given": dict(self.given)}

    def deal(self, sizes: Mapping[str, float]) -> dict[str, str]:
        """Split of each recording, by name, given the size of each.

        Of three recordings or more, every split with a share gets one at least.

        Raises:
            ConversionError: If a recording of `given` is not among them.
        """
        absent = sorted(set(self.given) - set(sizes))
        remedy = f"Known are {sorted(sizes)}."
        require(not absent, "given", "name recordings that are there", absent, "", remedy)
        free = {name: size for name, size in sizes.items() if name not in self.given}
        dealt = self._dealt(free) | dict(self.given)
        return {name: dealt[name] for name in sizes}

    def _dealt(self, sizes: Mapping[str, float]) -> dict[str, str]:
        bounds = np.cumsum(self.shares) * sum(sizes.values())
        order = sorted(sizes, key=lambda name: hashlib.sha256((self.salt + name).encode()).digest())
        numbers, dealt = [], 0.0
        for name in order:
            middle = dealt + sizes[name] / 2.0
            numbers.append(min(int(np.searchsorted(bounds, middle)), 2))
            dealt += sizes[name]
        if len(order) >= len(SPLITS):
            # few recordings: the first and the last ones make sure that no split is empty
            wanted = [number for number, share in enumerate(self.shares) if share > 0.0]
            numbers[0], numbers[-1] = wanted[0], wanted[-1]
            numbers[-2] = numbers[-2] if {*wanted} <= {*numbers} else wanted[1]
        return {name: SPLITS[number] for name, number in zip(order, numbers, strict=True)}
