"""Many crowds side by side as one vectorised gymnasium environment: one batch of the world."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffstack_mmv.checks import require, require_at_least, require_one_of, require_whole
from diffstack_mmv.simulation.env import CrowdNavEnv, begun, require_render_mode
from diffstack_mmv.simulation.phases import PHASES
from diffstack_mmv.simulation.scene import CaseSource
from diffstack_mmv.simulation.views import View, WorldView
from diffstack_mmv.simulation.world import World, WorldState
from diffstack_mmv.types import Outcome, map_tensors


class VectorStep(NamedTuple):
    """What gymnasium expects of a vectorised step, in its order and by its names."""

    observation: Any
    reward: Float[np.ndarray, " n"]
    terminated: Bool[np.ndarray, " n"]
    truncated: Bool[np.ndarray, " n"]
    info: dict[str, Any]


class CrowdNavVectorEnv(VectorEnv[Any, np.ndarray, np.ndarray]):
    """Episodes of one world, stepped as one batch; who has ended starts anew in the same step.

    Actions are controls of the robot, (n, m), as in `CrowdNavEnv`. The last observation of an
    episode that ended is row i of `info["final_obs"]`, its outcome that of `info["outcome"]`, where
    `info["_final_obs"]` is true. Cases of the training phase are drawn by the generator that
    `reset(seed=...)` seeds; `reset(options={"phase": "val", "cases": range(n)})` starts given ones.

    Args:
        world: The world.
        scenario: Where its episodes start.
        num_envs: Number n of episodes at once.
        view: What is shown of an observation; the arrays of `CrowdNavEnv` if None.
        progress_reward: Besides the reward of the world, per metre nearer to the goal.
        render_mode: "rgb_array" or None.

    Raises:
        ValueError: There is no episode, or the render mode is unknown.
    """

    metadata: dict[str, Any] = {
        **CrowdNavEnv.metadata,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        world: World,
        scenario: CaseSource,
        num_envs: int,
        view: View | None = None,
        progress_reward: float = 0.0,
        render_mode: str | None = None,
    ) -> None:
        require_whole("num_envs", num_envs)
        require_at_least("num_envs", num_envs, 1)
        require_render_mode(render_mode)
        self.render_mode = render_mode
        self.metadata = {**type(self).metadata, "render_fps": round(1 / world.dt_s)}
        self.world, self.scenario, self.num_envs = world, scenario, num_envs
        self.view = view or WorldView()
        self.progress_reward = progress_reward
        pedestrians = scenario.cases("train", [0]).pedestrians.radius.shape[-1]
        lower, upper = (bound.double().numpy() for bound in world.robot.bounds)
        self.single_action_space = spaces.Box(lower, upper, dtype=np.float64)
        self.single_observation_space = self.view.space(pedestrians)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._state: WorldState | None = None
        self._phase, self._cases = "train", np.zeros(num_envs, np.int64)

    @property
    def state(self) -> WorldState:
        """State of all episodes, SI units.

        Raises:
            RuntimeError: `reset` has not been called.
        """
        return begun(self._state)

    def reset(
        self, *, seed: int | list[int] | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start all episodes.

        Args:
            seed: Seeds the generator that draws cases; of a list the first entry.
            options: "phase" and "cases", one number per episode; without them cases are drawn from
                "train". Episodes that begin later are drawn from the same phase.

        Returns:
            Observations, and the numbers of the cases.

        Raises:
            ValueError: An option, phase or case does not exist, or there are not n cases.
        """
        super().reset(seed=seed[0] if isinstance(seed, list) else seed)
        chosen = dict(options or {})
        for name in chosen:
            require_one_of("options", name, ("phase", "cases"))
        self._phase, count = str(chosen.get("phase", "train")), self.num_envs
        require_one_of("phase", self._phase, tuple(PHASES))
        cases = np.atleast_1d(chosen["cases"]) if "cases" in chosen else self._drawn(count)
        require(len(cases) == count, "cases", f"be {count}, one per episode", len(cases))
        self._state = self.world.start(self.scenario.cases(self._phase, cases.tolist()))
        self._cases = cases.copy()
        return self._shown(self._state), {"case": cases}

    @torch.no_grad()
    def step(self, actions: np.ndarray) -> VectorStep:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Advance all episodes by one step.

        Args:
            actions: Controls in the units of the robot, (n, m).

        Returns:
            Observations, rewards, whether the goal or a pedestrian was hit, whether the time is up,
            and what is told of each episode: outcome, clearance (m), time (s), and the number of
            the case, of the next one where an episode has ended.

        Raises:
            ValueError: An action is not finite or has the wrong shape.
        """
        before = self.state
        control = torch.as_tensor(np.asarray(actions, dtype=np.float64))
        after, judgement = self.world.step(before, control)
        reward = judgement.reward
        if self.progress_reward:
            nearer = self.world.way_left(before) - self.world.way_left(after)
            reward = reward + self.progress_reward * nearer
        outcome = judgement.outcome
        terminated = (outcome == Outcome.COLLISION) | (outcome == Outcome.SUCCESS)
        truncated = outcome == Outcome.TIMEOUT
        told: dict[str, Any] = {
            "outcome": outcome.numpy(),
            "clearance_m": judgement.clearance.numpy(),
            "time_s": after.time.numpy().copy(),  # else a view of the clock of the episodes
        }
        ended = terminated | truncated
        if bool(ended.any()):
            told |= {"final_obs": self._shown(after), "_final_obs": ended.numpy()}
            after = self._begun_anew(after, ended.nonzero().squeeze(-1))
        self._state = after
        told["case"] = self._cases.copy()
        return VectorStep(
            self._shown(after), reward.numpy(), terminated.numpy(), truncated.numpy(), told
        )

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Picture of each episode, (height, width, 3) uint8, or None without a render mode."""
        if self.render_mode is None:
            return None
        from diffstack_mmv.simulation.drawing import picture

        return tuple(
            picture(self.world, map_tensors(lambda entry, row=row: entry[row], self.state))
            for row in range(self.num_envs)
        )

    def _begun_anew(self, state: WorldState, rows: Int[Tensor, " r"]) -> WorldState:
        """The state with other cases in some of its rows."""
        numbers = self._drawn(len(rows))
        self._cases[rows.numpy()] = numbers
        start = self.world.start(self.scenario.cases(self._phase, numbers.tolist()))
        return map_tensors(lambda old, new: old.index_copy(0, rows, new), state, start)

    def _drawn(self, count: int) -> Int[np.ndarray, " count"]:
        return self.np_random.integers(PHASES[self._phase].cases, size=count)

    def _shown(self, state: WorldState) -> Any:
        return self.view(self.world.observe(state))


def crowd_nav_vector(num_envs: int = 1, **settings: Any) -> CrowdNavVectorEnv:
    """What `gymnasium.make_vec("diffstack_mmv/CrowdNav-v0", num_envs=...)` makes.

    Args:
        num_envs: Number of episodes at once.
        **settings: Those of `CrowdNavEnv`.

    Raises:
        ValueError: As `CrowdNavEnv`, or there is no episode.
    """
    single = CrowdNavEnv(**settings)
    mode = single.render_mode
    return CrowdNavVectorEnv(single.world, single.scenario, num_envs, render_mode=mode)
