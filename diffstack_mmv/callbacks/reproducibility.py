"""What a checkpoint needs beyond weights.

Where it came from, and the state of all random generators.
"""

import random
import re
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytorch_lightning as pl
import torch
from pytorch_lightning import callbacks
from pytorch_lightning.callbacks import Callback

from diffstack_mmv.checks import message
from dmmv_conventions.checkpoints import read_plain
from dmmv_conventions.differences import first_difference
from dmmv_conventions.versions import installed_version


class Provenance(Callback):
    """Stores in every checkpoint configuration, recordings, commit and versions.

    A run whose folder was moved goes on with its best score: Lightning keeps that only where the
    checkpoints lie at their old place, and a worse one would then take the place of `best.ckpt`.

    Args:
        config: The resolved configuration as plain containers.
        learned_from: Tells the names of the recordings by data set, once they are read.
    """

    def __init__(
        self,
        config: Mapping[str, Any],
        learned_from: Callable[[], Mapping[str, Sequence[str]]] = dict,
    ) -> None:
        self.config = dict(config)
        self.learned_from = learned_from

    def on_save_checkpoint(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Add the provenance to a checkpoint."""
        checkpoint["provenance"] = {
            "config": self.config,
            "data": dict(self.learned_from()),
            "commit": current_commit(),
            "torch": str(torch.__version__),
            "diffstack_mmv": installed_version(),
        }

    def on_load_checkpoint(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Have the checkpoints of a run lie where its folder is now."""
        states = checkpoint.get("callbacks", {})
        for each in trainer.checkpoint_callbacks:
            if not isinstance(each, callbacks.ModelCheckpoint) or each.state_key not in states:
                continue
            if each.dirpath is not None:
                states[each.state_key] = _moved(states[each.state_key], str(each.dirpath))


def _moved(state: Mapping[str, Any], folder: str) -> dict[str, Any]:
    """The state of a `ModelCheckpoint`, its paths in another folder."""
    before = str(state["dirpath"])

    def moved(value: Any) -> Any:
        if isinstance(value, dict):
            return {moved(key): each for key, each in value.items()}
        if isinstance(value, str) and Path(value).is_relative_to(before):
            return str(Path(folder) / Path(value).relative_to(before))
        return value

    return {key: moved(value) for key, value in state.items()} | {"dirpath": folder}


def current_commit() -> str:
    """Commit of the checkout this package runs from, `unknown` outside of one."""
    try:
        answer = subprocess.run(
            ["git", "rev-parse", "HEAD"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return answer.stdout.strip()


class EarlyStopping(callbacks.EarlyStopping):
    """Lightning's, which forgets that a run has stopped and, resumed, trains an epoch more."""

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Stop at once where the checkpoint is that of a run that stopped."""
        # a run that has not been validated has not stopped, whatever its patience
        if self.wait_count >= max(self.patience, 1):
            trainer.should_stop = True


class RandomState(Callback):
    """Saves and restores all random generators: a resumed run goes on as if never stopped.

    Each process has its own. One that a run did not have before keeps the state it begins with.
    """

    def __init__(self) -> None:
        self._restored: list[dict[str, Any]] = []

    def state_dict(self) -> dict[str, Any]:
        """States of the generators of Python, numpy, torch and every CUDA device by process.

        All processes ask for it together, since they save together.
        """
        states: list[Any] = [_generators()]
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            [own] = states
            states = [None] * torch.distributed.get_world_size()
            torch.distributed.all_gather_object(states, own)
        return {"processes": states}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Keep the states until training starts: building the loaders draws numbers, too."""
        # checkpoints of earlier versions hold that of the first process alone
        self._restored = state_dict.get("processes", [state_dict])

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Restore the generators."""
        states, self._restored = self._restored, []
        if trainer.global_rank >= len(states):
            return
        state = states[trainer.global_rank]
        version, internal, gauss = state["python"]
        random.setstate((version, tuple(internal), gauss))
        _set_numpy_state(state["numpy"])
        torch.set_rng_state(state["torch"].cpu())
        if state["cuda"] and torch.cuda.is_available():
            torch.cuda.set_rng_state_all([value.cpu() for value in state["cuda"]])


def _generators() -> dict[str, Any]:
    return {
        "python": random.getstate(),
        "numpy": _numpy_state(),
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_available() else [],
    }


def _numpy_state() -> dict[str, Any]:
    # plain numbers: a checkpoint is read without unpickling objects
    state = np.random.get_state(legacy=False)
    inner = state["state"]
    return dict(state) | {"state": {"key": inner["key"].tolist(), "pos": int(inner["pos"])}}


def _set_numpy_state(state: Mapping[str, Any]) -> None:
    key = np.array(state["state"]["key"], dtype=np.uint32)
    np.random.set_state(dict(state) | {"state": {"key": key, "pos": state["state"]["pos"]}})


def resume_point(last: Path, config: Mapping[str, Any]) -> Path | None:
    """Checkpoint from which an interrupted run of this configuration continues, if there is one.

    Raises:
        ValueError: The folder holds a run of another configuration, or a broken checkpoint.
    """
    if not last.exists():
        return None
    remedy = "Delete it to begin anew, or choose another `out`."
    content = read_plain(last, remedy)
    stored = content.get("provenance") if isinstance(content, dict) else None
    before = stored.get("config") if isinstance(stored, dict) else None
    if not isinstance(before, dict):
        fault = message("checkpoint", "hold its configuration", "none", f"in {last}", remedy)
        raise ValueError(fault)
    may_differ = _ELSEWHERE_AND_MOVED if _DATA in content else _ELSEWHERE
    _require_same_training(last, before, config, may_differ)
    return last


def _require_same_training(
    last: Path, before: Mapping[str, Any], now: Mapping[str, Any], may_differ: re.Pattern[str]
) -> None:
    """Refuse a checkpoint of other settings, and name the outermost that differs."""
    found = first_difference(before, now, may_differ)
    if found is not None:
        requirement = "be a new folder, or that of the same run"
        got = f"with another {found.place}: {found.before!r} before, now {found.now!r}"
        remedy = f"Choose another `out`, with start={last} for its weights, or delete the folder."
        raise ValueError(message("out", requirement, f"{last.parents[1]} {got}", "", remedy))


_ELSEWHERE = re.compile(
    r"(out|epochs|vehicle_file|logger|dry_run|data\.root|data\.recordings"
    r"|data\.module\.loading\.workers|data\.module\.export\.workers"
    r"|trainer\.(accelerator|devices|num_nodes|strategy|use_distributed_sampler|plugins"
    r"|default_root_dir|max_epochs|max_steps|max_time|log_every_n_steps|profiler|enable_\w+)"
    r"|callbacks\.(learning_rate|rows|wall_clock|compiled_solver|preemption|parameters|gradients"
    r"|throughput|plans|artifact|progress))(\.|\[|$)"
)
"""Settings that may change when a run goes on: how long, where, what is read and shown."""

_DATA = "TrajdataModule"
"""Where Lightning keeps the state of the data module, which refuses other recordings."""
_MOVED = r"data\.(cache|module\.(source|export)\.folder)$"
_ELSEWHERE_AND_MOVED = re.compile(f"{_ELSEWHERE.pattern}|{_MOVED}")
"""And the place of the cache, which a job may copy to a disk of its own."""
