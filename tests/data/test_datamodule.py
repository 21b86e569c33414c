"""The data module inside and outside of Lightning."""

import shutil
from types import SimpleNamespace

import pytest
import pytorch_lightning as pl
import torch
from torch.utils._pytree import tree_flatten

from diffstack_mmv.data import (
    ConvertedCache,
    EqualModes,
    LoaderSettings,
    Mirror,
    Splits,
    TrajdataModule,
)
from diffstack_mmv.types import StackBatch


class Recorder(pl.LightningModule):
    """Remembers what it is trained on, and saves a checkpoint after some steps."""

    def __init__(self, save_after=None, checkpoint=None):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(()))
        self.seen, self.save_after, self.checkpoint = [], save_after, checkpoint

    def training_step(self, batch: StackBatch, batch_idx: int):
        self.seen.append((self.current_epoch, batch.goal.sum().item()))
        return self.weight * batch.goal.sum()

    def on_train_batch_end(self, *_):
        if len(self.seen) == self.save_after:
            self.trainer.save_checkpoint(self.checkpoint)

    def validation_step(self, batch: StackBatch, batch_idx: int):
        self.log("val", batch.goal.sum(), batch_size=len(batch.goal))

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), lr=0.0)


def trainer(folder, **options):
    return pl.Trainer(
        accelerator="cpu",
        devices=1,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        default_root_dir=folder,
        **options,
    )


@pytest.fixture
def module(source, windows, exporting):
    def build(workers=0, batch_size=8, seed=3, export=exporting, **options):
        loading = LoaderSettings(batch_size, workers, seed)
        return TrajdataModule(source, windows, loading, export, **options)

    return build


def batches(loader):
    """The tensors of every batch."""
    leaves = [tree_flatten(batch)[0] for batch in loader]
    return [[part for part in each if isinstance(part, torch.Tensor)] for each in leaves]


def equal(first, second):
    return len(first) == len(second) and all(
        torch.equal(a, b)
        for x, y in zip(first, second, strict=True)
        for a, b in zip(x, y, strict=True)
    )


@pytest.mark.parametrize("other", [{"workers": 2}, {"export": None}], ids=["workers", "direct"])
def test_neither_workers_nor_the_way_of_reading_change_a_batch(module, other):
    loaders = []
    for options in ({}, other):
        built = module(augmentation=Mirror(), balance=EqualModes(), **options)
        built.prepare_data()
        loaders.append(batches(built.train_dataloader()))
    assert equal(*loaders)


def test_evaluation_follows_the_table_of_samples(module):
    built = module()
    built.prepare_data()
    built.setup("test")
    samples = built.samples("test")
    modes = torch.cat([batch.ego_past.mode for batch in built.test_dataloader()])
    assert modes.tolist() == samples["mode"].tolist()
    assert list(samples.columns[:5]) == ["dataset", "scene", "agent", "row", "mode"]


def test_only_the_splits_of_the_stage_are_exported(module, tmp_path):
    built = module(splits=Splits(train="val", val="val", test="val"))
    built.prepare_data()
    exports = [path.name for path in (tmp_path / "exports").iterdir() if path.is_dir()]
    assert len(exports) == 1
    assert exports[0].startswith("toy_val_")


@pytest.mark.parametrize(
    ("limit", "setting"),
    [("train", "trainer.limit_train_batches"), ("val", "validation.share")],
)
def test_a_share_that_holds_no_batch_is_refused_with_the_least_that_does(
    module, tmp_path, limit, setting
):
    built = module(batch_size=1000)
    wanted = f"`{setting}` must be at least 1, one of 1 batches, but got 0.5"
    taken = trainer(tmp_path, max_epochs=1, **{f"limit_{limit}_batches": 0.5})
    with pytest.raises(ValueError, match=wanted):
        taken.fit(Recorder(), datamodule=built)


@pytest.mark.parametrize("split", ["train", "val"])
def test_a_process_without_a_sample_is_refused_in_all_of_them(module, split):
    built = module()
    built.prepare_data()
    count = len(built.dataset(split))
    limits = {"limit_train_batches": 1.0, "limit_val_batches": 1.0, "current_epoch": 0}
    loader = getattr(built, f"{split}_dataloader")
    for rank in (0, count - 1):
        built.trainer = SimpleNamespace(global_rank=rank, world_size=count, **limits)
        assert len(loader()) == 1
        built.trainer = SimpleNamespace(global_rank=rank, world_size=count + 1, **limits)
        wanted = f"`processes` must be at most {count}, the samples of the split '{split}'"
        with pytest.raises(ValueError, match=wanted):
            loader()


@pytest.mark.parametrize("rank", [0, 1])
def test_a_share_that_holds_no_batch_of_one_process_is_refused_in_all_of_them(module, rank):
    built = module()
    built.prepare_data()
    count = len(built.dataset("val"))
    built.loading = LoaderSettings(count // 2, 0, 3)
    assert count % 2 == 1, "the first process has a batch more"
    built.trainer = SimpleNamespace(global_rank=rank, world_size=2, limit_val_batches=0.5)
    with pytest.raises(ValueError, match="`validation.share` must be at least 1, one of 1 batches"):
        built.val_dataloader()


@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize("stop", [5, 21])
def test_training_resumes_within_an_epoch_where_it_stopped(module, tmp_path, workers, stop):
    def fit(recorder, **options):
        built = module(workers, batch_size=2, augmentation=Mirror())
        trainer(tmp_path, max_epochs=2).fit(recorder, datamodule=built, **options)
        return recorder.seen

    whole = fit(Recorder(stop, tmp_path / "some.ckpt"))
    assert 5 < len(whole) // 2 < 21 < len(whole)
    rest = fit(Recorder(), ckpt_path=tmp_path / "some.ckpt", weights_only=False)
    assert rest == whole[stop:]


def test_a_run_goes_on_with_the_conversion_it_began_with_alone(module, source, tmp_path):
    """Wherever it lies: a job may have copied it to a disk of its own."""
    saved, moved = tmp_path / "some.ckpt", tmp_path / "moved"
    trainer(tmp_path, max_epochs=1).fit(Recorder(1, saved), datamodule=module())
    shutil.copytree(source.folder, moved)
    elsewhere = module()
    elsewhere.source = ConvertedCache(source.name, str(moved))
    again = trainer(tmp_path, max_epochs=1)
    again.fit(Recorder(), datamodule=elsewhere, ckpt_path=saved, weights_only=False)
    (moved / source.name / "conversion_report.json").write_text('{"smoother": "another"}')
    with pytest.raises(ValueError, match="`data` must be the recordings of 'toy', converted as"):
        again.fit(Recorder(), datamodule=elsewhere, ckpt_path=saved, weights_only=False)


def test_a_run_after_a_whole_epoch_goes_on_with_the_next_one(module, tmp_path):
    whole = Recorder()
    trainer(tmp_path, max_epochs=2).fit(whole, datamodule=module(2))
    one = trainer(tmp_path, max_epochs=1)
    one.fit(Recorder(), datamodule=module(2))
    one.save_checkpoint(tmp_path / "last.ckpt")
    second = Recorder()
    two = trainer(tmp_path, max_epochs=2)
    two.fit(second, datamodule=module(2), ckpt_path=tmp_path / "last.ckpt", weights_only=False)
    assert second.seen == whole.seen[len(whole.seen) // 2 :]


@pytest.mark.parametrize(("name", "before", "after"), [("batch_size", 8, 4), ("seed", 3, 5)])
def test_resuming_with_another_setting_is_refused(module, name, before, after):
    built = module()
    built.prepare_data()
    state = built.train_dataloader().state_dict()
    other = module(**{name: after}).train_dataloader()
    complaint = f"`{name}` must be {before} as in the checkpoint, but got {after}"
    with pytest.raises(ValueError, match=complaint):
        other.load_state_dict(state)


def test_batches_move_to_a_device_as_they_are(module):
    built = module()
    built.prepare_data()
    batch = next(iter(built.test_dataloader()))
    moved = built.transfer_batch_to_device(batch, torch.device("meta"), 0)
    assert isinstance(moved, StackBatch)
    assert moved.dt_s == 0.1
    assert moved.ego_past.motion.position.device.type == "meta"


def test_an_export_that_was_not_prepared_is_told(module):
    with pytest.raises(ValueError, match="`export` must be complete, but got no such file"):
        module().setup("fit")


def test_reading_batches_leaves_the_random_numbers_of_the_training_alone(module):
    built = module()
    built.prepare_splits(["train"])
    loader = built.train_dataloader()
    before = torch.get_rng_state()
    next(iter(loader))
    assert torch.equal(torch.get_rng_state(), before)


def test_the_hash_of_the_samples_changes_with_them(module):
    hashes = []
    for split in ("test", "test", "val"):
        built = module()
        built.prepare_splits([split])
        hashes.append(built.dataset(split).digest())
    assert hashes[0] == hashes[1] != hashes[2]
