"""Driving policies learned by reinforcement, with stable-baselines3 (extra `rl`)."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any
from zipfile import BadZipFile

from diffstack_mmv.checks import message, require, require_at_least, require_positive
from diffstack_mmv.simulation.vector_env import CrowdNavVectorEnv
from diffstack_mmv.types import Outcome
from dmmv_conventions.disk import replacing
from dmmv_conventions.extras import needs
from dmmv_conventions.progress import waiting

with needs("rl", "reinforcement learning"):
    from stable_baselines3 import PPO  # pyright: ignore[reportMissingImports]
    from stable_baselines3.common.callbacks import (  # pyright: ignore[reportMissingImports]
        BaseCallback,
    )

    from diffstack_mmv.simulation.stable_baselines_env import StableBaselinesEnv

KEPT_EVERY_S = 10.0
"""Processor time between two states of a training that are kept in case it is interrupted."""


class _Clock(BaseCallback):
    """Ends a training after a processor time, counts outcomes per update, and keeps its state."""

    def __init__(self, seconds: float, curve: list[dict[str, Any]], kept: Path) -> None:
        super().__init__()
        self.seconds = seconds
        self.began = time.process_time() - (curve[-1]["seconds"] if curve else 0.0)
        self.last_kept = time.process_time()
        self.outcomes: list[int] = []
        self.curve = curve
        self.kept = kept

    def _on_rollout_start(self) -> None:
        """Between two updates: what is kept has learned from all that it counts."""
        if time.process_time() - self.last_kept >= KEPT_EVERY_S:
            self.model.curve = self.curve
            _save(self.model, self.kept)
            self.last_kept = time.process_time()

    def _on_step(self) -> bool:
        """Note who has ended; go on while there is time."""
        self.outcomes += [told["outcome"] for told in self.locals["infos"] if "outcome" in told]
        return time.process_time() - self.began < self.seconds

    def _on_rollout_end(self) -> None:
        counts = {each.label: self.outcomes.count(each) for each in Outcome if each.ends_episode}
        row = {"steps": self.num_timesteps, "seconds": time.process_time() - self.began}
        self.curve.append(row | {"outcomes": counts})
        self.outcomes = []


@dataclass(frozen=True)
class _FallingRate:
    """A learning rate that falls to nearly zero with the processor time."""

    first: float
    seconds: float
    began: float

    def __call__(self, _: float) -> float:
        left = 1 - (time.process_time() - self.began) / self.seconds
        return self.first * max(left, 0.02)


@dataclass(frozen=True)
class PPOTraining:
    """Proximal policy optimisation with a small network, for a given processor time.

    Attributes:
        seconds: Processor time.
        steps: Per episode and update.
        minibatch: Steps per gradient, at least two.
        epochs: Passes over the steps of an update.
        learning_rate: Of Adam; falls to zero with the time.
        discount: Of rewards one step later.
        layers: Widths of the hidden layers of actor and critic.
        seed: Of weights, actions and cases.

    Raises:
        ValueError: A number is not positive, or too small or large for what it is.

    Source:
        Schulman et al., Proximal Policy Optimization Algorithms (2017).
    """

    seconds: float = 600.0
    steps: int = 64
    minibatch: int = 1024
    epochs: int = 6
    learning_rate: float = 5e-4
    discount: float = 0.985
    layers: Sequence[int] = (128, 128)
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the numbers once, at the border."""
        require_at_least("steps", self.steps, 1)
        require_at_least("minibatch", self.minibatch, 2)
        for name in ("seconds", "epochs", "learning_rate", "discount"):
            require_positive(name, getattr(self, name))
        require(self.discount <= 1, "discount", "lie in (0, 1]", self.discount)

    def __call__(self, env: CrowdNavVectorEnv, path: Path) -> list[dict[str, Any]]:
        """Train, and keep the policy in a file, all or nothing.

        The state of a training that was interrupted lies beside the file, and is gone on with; the
        crowds begin anew.

        Args:
            env: Where it drives.
            path: The file, .zip.

        Returns:
            Per update: steps so far, processor seconds, and how many episodes ended how.

        Raises:
            ValueError: An update is of a single step, or the time is too short for any update.
        """
        of_update = self.steps * env.num_envs
        require(of_update >= 2, "steps", "give two in all episodes of an update", of_update)
        kept = path.with_name(f"{path.stem}_unfinished{path.suffix}")
        before = PPO.load(kept, device="cpu") if kept.is_file() else None
        clock = _Clock(self.seconds, [] if before is None else before.curve, kept)
        model = self._model(StableBaselinesEnv(env), clock)
        if before is not None:
            model.set_parameters(before.get_parameters())
            model.num_timesteps = before.num_timesteps
        with waiting(f"train a policy for {self.seconds:g} s of a processor"):
            model.learn(2**40, callback=clock, reset_num_timesteps=False)
        wanted = f"suffice for an update of {of_update} steps"
        require(len(clock.curve) > 0, "seconds", wanted, self.seconds)
        _save(model, path)
        kept.unlink(missing_ok=True)
        return clock.curve

    def _model(self, env: StableBaselinesEnv, clock: _Clock) -> PPO:
        rate = _FallingRate(self.learning_rate, self.seconds, clock.began)
        # other crowds than those from which it has learned before it was interrupted
        seed = self.seed + len(clock.curve)
        return PPO(
            "MlpPolicy", env, learning_rate=rate, n_steps=self.steps, batch_size=self.minibatch,
            n_epochs=self.epochs, gamma=self.discount, device="cpu", seed=seed,
            policy_kwargs={"net_arch": list(self.layers), "log_std_init": -0.5},
        )  # fmt: skip


def _save(model: PPO, path: Path) -> None:
    with replacing(path) as unfinished, unfinished.open("wb") as stream:
        model.save(stream)


def load_policy(path: Path) -> Any:
    """The trained policy in a file, which is to be trusted like code: it holds pickles.

    Raises:
        ValueError: The file holds none.
    """
    try:
        return PPO.load(path, device="cpu").policy
    except _BROKEN as broken:
        found = f"{type(broken).__name__}: {broken}".splitlines()[0]
        remedy = "Train one: dmmv-train-policy, policy=DIR/policy.zip."
        told = message("policy", "be readable", found, f"in {path}", remedy)
        raise ValueError(told) from broken


# what stable-baselines3 raises where an archive holds something else than it writes
_BROKEN = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    BadZipFile,
    LookupError,
    RuntimeError,
    TypeError,
    UnpicklingError,
    ValueError,
)
