"""Per-sample evaluation of a trained stack beside its trivial baselines."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple, Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.prediction import Predictor, ego_forecast
from diffstack_mmv.planning import present
from diffstack_mmv.stack.module import DiffStackMMV, StackOutput, displacements
from diffstack_mmv.types import Motion, StackBatch


class Baseline(Protocol):
    """A trivial answer to the same question: a path of the ego."""

    def __call__(self, batch: StackBatch, goal: Float[Tensor, "B 2"]) -> Float[Tensor, "B T 2"]:
        """Path in m in the frame of the sample, given the goal (m) that the plan was given."""
        ...


class PredictedPath:
    """The most likely path of a simple predictor, which knows no goal."""

    def __init__(self, predictor: Predictor) -> None:
        self.predictor = predictor

    def __call__(self, batch: StackBatch, goal: Float[Tensor, "B 2"]) -> Float[Tensor, "B T 2"]:
        """Path in m; the goal is not used."""
        return ego_forecast(self.predictor.predict(batch)).most_likely()


class PathToGoal:
    """A path in closed form from the present motion to the goal.

    Args:
        path: (motion, goal, steps, dt_s) -> path.
    """

    def __init__(
        self, path: Callable[[Motion, Float[Tensor, "B 2"], int, float], Float[Tensor, "B T 2"]]
    ) -> None:
        self.path = path

    def __call__(self, batch: StackBatch, goal: Float[Tensor, "B 2"]) -> Float[Tensor, "B T 2"]:
        """Path in m that ends at the goal."""
        steps = batch.ego_future.valid.shape[-1]
        return self.path(present(batch.ego_past).motion, goal, steps, batch.dt_s)


class Evaluated(NamedTuple):
    """A batch, what the stack made of it, and how that scores."""

    batch: StackBatch
    output: StackOutput
    scores: dict[str, Tensor]  # one number per sample; baselines as name/ade and name/fde
    errors: dict[str, Float[Tensor, "B T"]]  # m, distance to the human over the horizon


def evaluate_batches(
    stack: DiffStackMMV, baselines: Mapping[str, Baseline], batches: Iterable[StackBatch]
) -> Iterator[Evaluated]:
    """Evaluate batch by batch, without gradients; the stack has to be in evaluation mode and on the device of the batches."""
    for batch in batches:
        with torch.no_grad():
            output = stack(batch)
            scores = stack.score(batch, output)
            human = batch.ego_future.motion.position
            paths = {"prediction": ego_forecast(output.forecast).most_likely()}
            paths["plan"] = output.plan.motion.position[..., 1:, :]
            for name, baseline in baselines.items():
                paths[name] = baseline(batch, output.goal)
                scores |= displacements(f"{name}/", paths[name], batch)
        errors = {name: (path - human).square().sum(-1).sqrt() for name, path in paths.items()}
        yield Evaluated(batch, output, scores, errors)
