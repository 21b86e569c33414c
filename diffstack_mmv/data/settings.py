"""What a sample is, how samples are loaded, and where they are kept."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from diffstack_mmv.checks import (
    require,
    require_at_least,
    require_multiple,
    require_positive,
    require_switch,
)
from diffstack_mmv.types import Mode


@dataclass(frozen=True)
class WindowSettings:
    """Windows of one ego agent and its neighbors.

    A window exists at every `stride`-th row of an agent of the ego modes that has its full past and
    its full future. Training and evaluation use the same stride unless told otherwise: consecutive
    windows of one agent overlap, 5 steps apart they are still nearly independent in their future.

    Attributes:
        ego_modes: Names of the modes whose agents take the part of the ego.
        history_s: Past in s; the row of the present is counted on top of it.
        horizon_s: Future in s.
        dt_s: Step in s.
        neighbors: At most so many of the nearest agents.
        radius_m: Agents further away than this in m at the present are left out.
        stride: Steps between the presents of consecutive windows.

    Raises:
        ValueError: A mode is unknown or there is none, a duration is no multiple of `dt_s`, or a
            number is negative.
    """

    ego_modes: Sequence[str] = ("bicycle",)
    history_s: float = 4.0
    horizon_s: float = 3.0
    dt_s: float = 0.1
    neighbors: int = 16
    radius_m: float = 30.0
    stride: int = 5

    def __post_init__(self) -> None:
        object.__setattr__(self, "ego_modes", tuple(self.ego_modes))
        require(len(self.ego_modes) > 0, "ego_modes", "name at least one mode", self.ego_modes)
        require_positive("dt_s", self.dt_s)
        require_multiple("history_s", self.history_s, self.dt_s)
        require_multiple("horizon_s", self.horizon_s, self.dt_s)
        require_at_least("neighbors", self.neighbors, 0)
        require_positive("radius_m", self.radius_m)
        require_at_least("stride", self.stride, 1)
        for name in self.ego_modes:
            Mode.named(name, "ego_modes")

    @property
    def modes(self) -> tuple[Mode, ...]:
        """The modes of the ego."""
        return tuple(Mode.named(name) for name in self.ego_modes)

    @property
    def past_rows(self) -> int:
        """Rows of the past, the present included."""
        return require_multiple("history_s", self.history_s, self.dt_s) + 1

    @property
    def future_rows(self) -> int:
        """Rows of the future."""
        return require_multiple("horizon_s", self.horizon_s, self.dt_s)

    @property
    def rows(self) -> int:
        """Rows of past and future together."""
        return self.past_rows + self.future_rows

    def content(self) -> dict[str, object]:
        """All settings as plain values: they decide what an export holds."""
        return {**asdict(self), "ego_modes": sorted(self.ego_modes)}


@dataclass(frozen=True)
class LoaderSettings:
    """How batches are loaded.

    Attributes:
        batch_size: Samples per batch and process.
        workers: Loading processes per training process; 0 loads in the training process, which
            is fastest for exports: handing a batch over costs more than reading it.
        seed: Decides order and augmentation together with the epoch.

    Raises:
        ValueError: A number is out of range.
    """

    batch_size: int = 64
    workers: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        require_at_least("batch_size", self.batch_size, 1)
        require_at_least("workers", self.workers, 0)
        require_at_least("seed", self.seed, 0)


@dataclass(frozen=True)
class ExportSettings:
    """Where exports are kept and how they are made.

    Attributes:
        folder: Parent of the folders of all exports.
        workers: Processes; 0 exports in this one.
        progress: Whether to show a progress bar.

    Raises:
        ValueError: The number of workers is negative.
    """

    folder: str
    workers: int = 0
    progress: bool = True

    def __post_init__(self) -> None:
        require_at_least("workers", self.workers, 0)
        require_switch("progress", self.progress)
