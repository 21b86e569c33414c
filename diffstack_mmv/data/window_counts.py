"""Counts what becomes of the rows of all agents: windows, or why not."""

from collections import Counter
from enum import StrEnum

from diffstack_mmv.checks import require
from diffstack_mmv.data.settings import WindowSettings
from diffstack_mmv.types import Mode


class RowFate(StrEnum):
    """What a row of an agent is, seen as the present of a window."""

    WINDOW = "window"
    OTHER_MODE = "mode_is_no_ego_mode"
    TRACK_TOO_SHORT = "track_shorter_than_a_window"
    NO_FULL_HISTORY = "no_full_history"
    NO_FULL_FUTURE = "no_full_future"
    BETWEEN_STRIDES = "between_strides"
    NOT_FINITE = "not_finite"


class WindowCounts:
    """Rows of all agents by mode and fate; the fates of a mode add up to its rows."""

    def __init__(self, windows: WindowSettings) -> None:
        """Start with no rows."""
        self._windows = windows
        self._counts: dict[int, Counter[RowFate]] = {}

    def add(self, mode: int, rows: int) -> None:
        """Count the rows of one gap-free track."""
        counts = self._counts.setdefault(mode, Counter())
        if mode not in self._windows.modes:
            counts[RowFate.OTHER_MODE] += rows
            return
        full = rows - self._windows.rows + 1
        if full < 1:
            counts[RowFate.TRACK_TOO_SHORT] += rows
            return
        kept = -(-full // self._windows.stride)
        counts[RowFate.NO_FULL_HISTORY] += self._windows.past_rows - 1
        counts[RowFate.NO_FULL_FUTURE] += self._windows.future_rows
        counts[RowFate.BETWEEN_STRIDES] += full - kept
        counts[RowFate.WINDOW] += kept

    def drop(self, mode: int, windows: int) -> None:
        """Turn windows of a mode into dropped ones, because they hold NaN or infinite values."""
        self._counts[mode][RowFate.WINDOW] -= windows
        self._counts[mode][RowFate.NOT_FINITE] += windows

    def as_dict(self) -> dict[str, dict[str, int]]:
        """Rows by name of the mode and of the fate."""
        known = {int(mode): mode.label for mode in Mode}
        return {
            known.get(mode, str(mode)): {str(fate): count for fate, count in counts.items()}
            for mode, counts in sorted(self._counts.items())
        }

    def _rows_told(self) -> str:
        """What became of the rows of the ego modes, and of which modes there are others."""
        counts = self.as_dict()
        own = {mode: counts.pop(mode, {}) for mode in self._windows.ego_modes}
        fates = [
            f"{mode} ({', '.join(f'{n} rows {fate}' for fate, n in told.items()) or 'no row'})"
            for mode, told in own.items()
        ]
        return f"{', '.join(fates)}; other modes: {', '.join(counts) or 'none'}"

    def require_windows(self, query: str) -> None:
        """Refuse a data set without a single window.

        Raises:
            ValueError: No agent of the ego modes has a full window.
        """
        found = sum(counts[RowFate.WINDOW] for counts in self._counts.values())
        require(
            found > 0,
            "ego_modes",
            f"have at least one window of {self._windows.rows} rows",
            f"none for {self._rows_told()}",
            f"in '{query}'",
            "Choose other modes, or a shorter history or horizon.",
        )
