"""Per-sample evaluation of a trained stack beside its trivial baselines."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import pandas as pd
import torch
from tqdm import tqdm

from diffstack_mmv.checks import require
from diffstack_mmv.metrics import (
    Calibration,
    coverages,
    excitation,
    judged_levels,
    where_known,
)
from diffstack_mmv.prediction import Baseline, ego_forecast
from diffstack_mmv.stack.judging import beside_baselines, judged_plans, judged_predictions
from diffstack_mmv.stack.module import DiffStackMMV
from diffstack_mmv.stack.output import StackOutput
from diffstack_mmv.types import Mode, StackBatch, map_tensors


@runtime_checkable
class Windows(Protocol):
    """Samples by number, with one row of `samples` about each."""

    @property
    def samples(self) -> pd.DataFrame:
        """One row per sample: at least `scene` and `mode`."""
        ...

    def __len__(self) -> int:
        """Number of samples."""
        ...

    def __getitem__(self, index: Sequence[int]) -> StackBatch:
        """Return the samples of these numbers."""
        ...


class Evaluation(NamedTuple):
    """What came out of a data set.

    Attributes:
        samples: One row per sample: identity, scores, the hindsight cost of the plan by term as
            cost/TERM, NAME/ade, NAME/fde of each baseline, NAME/nll where it is a forecast, and how
            hard the human rode.
        errors: Mode -> method -> mean distance (T,) to the human in m, NaN where nobody was
            recorded.
        levels: Mode -> levels of the truths, all samples and judged times in a row: the smallest
            region of highest density that holds each.
    """

    samples: pd.DataFrame
    errors: dict[str, dict[str, np.ndarray]]
    levels: dict[str, np.ndarray]


def evaluate_windows(
    stack: DiffStackMMV,
    baselines: Mapping[str, Baseline],
    windows: Windows,
    batch_size: int = 64,
    plans: bool = True,
    calibration: Calibration | None = None,
    compile_from: float = math.inf,
    seed: int = 0,
) -> Evaluation:
    """Score every sample, in order, on the device of the stack.

    Args:
        stack: The trained stack.
        baselines: Trivial answers by their names.
        windows: The samples.
        batch_size: How many at a time.
        plans: Whether anything is planned; without, only the prediction is judged.
        calibration: Corrects the regions whose coverage is told, see `fitted_calibration`.
        compile_from: Number of samples from which on the kernels are compiled, which may change
            scores in their last digit.
        seed: Of the paths that are drawn for scores; nothing else is random.

    Raises:
        ValueError: There is no sample.
    """
    remedy = "Choose other modes or another split."
    require(len(windows) > 0, "windows", "hold at least one sample", 0, "", remedy)
    stack.eval()
    if len(windows) >= compile_from:
        stack.compile_kernels()
    scores: list[pd.DataFrame] = []
    errors: list[dict[str, np.ndarray]] = []
    levels: list[np.ndarray] = []
    judge = judged_plans if plans else judged_predictions
    for start in tqdm(range(0, len(windows), batch_size), desc="evaluate", unit="batch"):
        batch = _batch(stack, windows, start, batch_size)
        judged = judge(stack, batch, start, seed)
        found = judged_levels(judged.forecast, batch.ego_future, seed=seed, first=start)
        row, error = beside_baselines(judged, baselines, batch)
        row |= coverages(found, calibration) | excitation(batch)
        levels.append(where_known(found.level, found.valid).cpu().numpy())
        scores.append(pd.DataFrame({name: value.cpu().numpy() for name, value in row.items()}))
        errors.append({name: value.cpu().numpy() for name, value in error.items()})
    samples = windows.samples.reset_index(drop=True)
    samples["mode"] = [Mode(mode).label for mode in samples["mode"]]
    joined = {name: np.concatenate([part[name] for part in errors]) for name in errors[0]}
    by_mode = {
        str(mode): {name: _known_mean(error[rows]) for name, error in joined.items()}
        for mode, rows in samples.groupby("mode", sort=True).indices.items()
    }
    table = pd.concat([samples, pd.concat(scores, ignore_index=True)], axis=1)
    return Evaluation(table, by_mode, _levels_by_mode(samples["mode"], np.concatenate(levels)))


def _levels_by_mode(modes: pd.Series, levels: np.ndarray) -> dict[str, np.ndarray]:
    return {
        mode: levels[modes == mode][~np.isnan(levels[modes == mode])] for mode in sorted(set(modes))
    }


@torch.no_grad()
def fitted_calibration(stack: DiffStackMMV, windows: Windows, batch_size: int = 64) -> Calibration:
    """Fit the regions of the forecasts of a stack to windows that it was not trained on.

    Raises:
        ValueError: There are too few windows that are known at each time to say anything of a
            region of 90 %.
    """
    require(len(windows) > 0, "windows", "hold at least one sample", 0)
    stack.eval()
    found = []
    for start in range(0, len(windows), batch_size):
        batch = _batch(stack, windows, start, batch_size)
        ego = ego_forecast(stack.predictor.predict(batch))
        found.append(judged_levels(ego, batch.ego_future, first=start))
    level, valid = (torch.cat([part[field] for part in found]) for field in (0, 1))
    calibration = Calibration.fitted(level, valid)
    known = int(valid.sum(0).min())
    enough = bool(calibration.levels.isfinite().all())
    remedy = "Give another calibration.split, more modes or a smaller data.stride."
    require(enough, "calibration.split", "hold 9 windows known at each time", known, "", remedy)
    return calibration


def representative(samples: pd.DataFrame, score: str = "plan_ade") -> dict[str, dict[str, int]]:
    """Numbers of the best, the median and the worst sample of each mode by a score (m).

    Where a mode has samples in motion (`moving`), only these are looked at; samples without the
    score are not, and a mode that has no other is absent.
    """
    chosen = {}
    numbers, values = np.arange(len(samples)), samples[score].to_numpy()
    for mode in sorted(set(samples["mode"])):
        of_mode = (samples["mode"] == mode).to_numpy() & ~np.isnan(values)
        if not of_mode.any():
            continue
        in_motion = of_mode & samples["moving"].to_numpy(bool)
        own = numbers[in_motion if in_motion.any() else of_mode]
        order = own[np.argsort(values[own], kind="stable")]
        chosen[mode] = {
            "best": int(order[0]),
            "median": int(order[len(order) // 2]),
            "worst": int(order[-1]),
        }
    return chosen


@torch.no_grad()
def outputs_of(
    stack: DiffStackMMV, windows: Windows, numbers: Sequence[int]
) -> tuple[StackBatch, StackOutput]:
    """Run the stack on a few samples, to look at them."""
    batch = _on_device(stack, windows[numbers])
    return batch, stack(batch)


def _batch(stack: DiffStackMMV, windows: Windows, start: int, size: int) -> StackBatch:
    """The samples from one on, so many or those that are left, on the device of the stack."""
    return _on_device(stack, windows[range(start, min(start + size, len(windows)))])


def _on_device(stack: DiffStackMMV, batch: StackBatch) -> StackBatch:
    return map_tensors(lambda tensor: tensor.to(stack.device), batch)


def _known_mean(error: np.ndarray) -> np.ndarray:
    """Mean over samples (n, T) where known, NaN at times without any."""
    known = ~np.isnan(error)
    total = np.where(known, error, 0.0).sum(0)
    return np.where(known.any(0), total / np.maximum(known.sum(0), 1), np.nan)
