"""The data module: recordings in, `StackBatch` out."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import pandas as pd
from pytorch_lightning import LightningDataModule
from torch import distributed

from diffstack_mmv.checks import require
from diffstack_mmv.data.augment import Augmentation
from diffstack_mmv.data.dataset import DirectWindows, ExportedWindows, WindowDataset
from diffstack_mmv.data.export import Export, export_windows
from diffstack_mmv.data.loading import DrawnWindows, WindowLoader, require_a_batch
from diffstack_mmv.data.sampling import Balance, EvaluationSampler, Share, TrainingSampler
from diffstack_mmv.data.settings import ExportSettings, LoaderSettings, WindowSettings
from diffstack_mmv.data.sources import WindowSource


@dataclass(frozen=True)
class Splits:
    """Which split of the data set serves which purpose."""

    train: str = "train"
    val: str = "val"
    test: str = "test"


_READING = ("root", "trajdata")
"""Where recordings lie and what reads them: not what they are."""

_NEEDED = {"fit": ("train", "val"), "validate": ("val",), "test": ("test",), "predict": ("test",)}


class TrajdataModule(LightningDataModule):
    """Yields `StackBatch` from any data set that trajdata can open.

    With several processes each one takes its own samples: in training all take equally many, in
    evaluation every sample is taken exactly once, so that metrics which synchronise when they are
    computed equal those of one process.
    """

    def __init__(
        self,
        source: WindowSource,
        windows: WindowSettings,
        loading: LoaderSettings,
        export: ExportSettings | None,
        splits: Splits | None = None,
        augmentation: Augmentation | None = None,
        balance: Balance | None = None,
    ) -> None:
        """Describe the data; nothing is read before `prepare_data`.

        Args:
            source: The data set.
            windows: What a sample is.
            loading: Batch size, workers and seed.
            export: Where samples are exported once; None reads trajdata anew, which is slow.
            splits: Names of the splits for training, validation and test.
            augmentation: Applied to training batches.
            balance: How often samples are drawn in training; None takes each once per epoch.
        """
        super().__init__()
        self.source = source
        self.windows = windows
        self.loading = loading
        self.export = export
        self.splits = splits or Splits()
        self.augmentation = augmentation
        self.balance = balance
        self._datasets: dict[str, WindowDataset] = {}
        self._recordings: str | None = None

    def prepare_data(self) -> None:
        """Export the splits that are needed, unless they are there; runs in one process per node.

        Raises:
            ValueError: The source cannot be opened or a split holds no window.
            OSError: The disk is full.
        """
        self.prepare_splits(self._needed(self._stage()))

    def prepare_splits(self, splits: Sequence[str]) -> None:
        """Export these splits, unless they are there or nothing is exported at all.

        Raises:
            ValueError: The source cannot be opened or a split holds no window.
            OSError: The disk is full.
        """
        if self.export is not None:
            _export_alone(
                [Export(self.source, split, self.windows) for split in splits], self.export
            )

    def setup(self, stage: str | None = None) -> None:
        """Open the splits of a stage ("fit", "validate", "test"), or all.

        Raises:
            ValueError: A split was not exported, or its export is damaged.
        """
        self._recordings = self._digest()
        for split in self._needed(stage):
            self.dataset(split)

    def state_dict(self) -> dict[str, str]:
        """A hash of the recordings and their conversion; a checkpoint holds it."""
        return {"recordings": self._recordings or self._digest()}

    def load_state_dict(self, state_dict: Mapping[str, str]) -> None:
        """Refuse to go on with other data than those of the checkpoint.

        Raises:
            ValueError: The recordings or their conversion are others.
        """
        same = state_dict["recordings"] == (self._recordings or self._digest())
        needs = f"be the recordings of '{self.source.name}', converted as when the training began"
        remedy = "Convert them as before, or train in another `out`."
        require(same, "data", needs, "others", "", remedy)

    def dataset(self, split: str) -> WindowDataset:
        """Samples of a split of the source, by number, without augmentation.

        Raises:
            ValueError: The split was not exported, or its export is damaged.
        """
        if split not in self._datasets:
            self._datasets[split] = self._open(split)
        return self._datasets[split]

    def samples(self, split: str) -> pd.DataFrame:
        """Tell of each sample of a split: dataset, scene, agent, row (time index), mode, situation.

        Evaluation in one process yields its samples in the order of this table; process r of P
        yields the rows r, r + P, r + 2 P, ...
        """
        return self.dataset(split).samples

    def train_dataloader(self) -> WindowLoader:
        """Batches for training: shuffled, augmented, balanced.

        Raises:
            ValueError: There are fewer samples than processes, the balance does not fit them, or
                the trainer takes a share that holds no batch.
        """
        dataset = self.dataset(self.splits.train)
        weights = None if self.balance is None else self.balance.weights(dataset.samples)
        share, loading = self._share(), self.loading
        self._require_enough(self.splits.train)
        sampler = TrainingSampler(len(dataset), loading.batch_size, loading.seed, share, weights)
        sampler.set_epoch(self.trainer.current_epoch if self.trainer else 0)
        loader = WindowLoader(DrawnWindows(dataset, self.augmentation), sampler, loading.workers)
        if self.trainer:
            limit = self.trainer.limit_train_batches
            require_a_batch("trainer.limit_train_batches", limit or 0, sampler.fewest)
        return loader

    def val_dataloader(self) -> WindowLoader:
        """Batches for validation, in order.

        Raises:
            ValueError: There are fewer samples than processes, or the trainer takes a share that
                holds no batch.
        """
        self._require_enough(self.splits.val)
        loader = self.evaluation_loader(self.splits.val)
        if self.trainer:
            limit = self.trainer.limit_val_batches
            require_a_batch("validation.share", limit or 0, loader.sampler.fewest)
        return loader

    def test_dataloader(self) -> WindowLoader:
        """Batches for the test, in order."""
        return self.evaluation_loader(self.splits.test)

    def predict_dataloader(self) -> WindowLoader:
        """Batches of the test split, in order."""
        return self.evaluation_loader(self.splits.test)

    def evaluation_loader(self, split: str) -> WindowLoader:
        """Batches of any split in order, each sample once."""
        dataset = self.dataset(split)
        sampler = EvaluationSampler(
            len(dataset), self.loading.batch_size, self.loading.seed, self._share()
        )
        return WindowLoader(DrawnWindows(dataset), sampler, self.loading.workers)

    def _require_enough(self, split: str) -> None:
        """Refuse a process without a sample: the others would wait for it for ever."""
        samples, processes = len(self.dataset(split)), self._share().processes
        needs = f"be at most {samples}, the samples of the split '{split}'"
        remedy = "Lower `trainer.devices`."
        require(samples >= processes, "processes", needs, processes, "", remedy)

    def _digest(self) -> str:
        told = {key: each for key, each in self.source.identity().items() if key not in _READING}
        return hashlib.sha256(json.dumps(told, sort_keys=True, default=str).encode()).hexdigest()

    def _open(self, split: str) -> WindowDataset:
        if self.export is None:
            return DirectWindows(self.source.open(split, self.windows), self.source.name)
        return ExportedWindows(Export(self.source, split, self.windows).folder(self.export))

    def _needed(self, stage: str | None) -> list[str]:
        purposes = _NEEDED.get(stage or "", ("train", "val", "test"))
        return list(dict.fromkeys(getattr(self.splits, purpose) for purpose in purposes))

    def _stage(self) -> str | None:
        return self.trainer.state.fn.value if self.trainer and self.trainer.state.fn else None

    def _share(self) -> Share:
        return Share(self.trainer.global_rank, self.trainer.world_size) if self.trainer else Share()


def _export_alone(exports: Sequence[Export], settings: ExportSettings) -> None:
    """Export outside of a process group: trajdata waits for all of its members when it opens."""
    if not (distributed.is_available() and distributed.is_initialized()):
        _export_all(exports, settings)
    elif not all(export.exists(settings) for export in exports):
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            pool.submit(_export_all, exports, settings).result()


def _export_all(exports: Sequence[Export], settings: ExportSettings) -> None:
    for export in exports:
        export_windows(export, settings)
