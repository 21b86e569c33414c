"""The vectorised crowd as stable-baselines3 sees it (extra `rl`)."""

from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv  # pyright: ignore[reportMissingImports]

from diffstack_mmv.simulation.vector_env import CrowdNavVectorEnv


class StableBaselinesEnv(VecEnv):
    """A vectorised crowd as stable-baselines3 sees it; actions are shares of the bounds in [-1, 1].

    Args:
        env: The crowd, whose view is one row of numbers.
    """

    def __init__(self, env: CrowdNavVectorEnv) -> None:
        self.env = env
        columns = len(env.world.robot.bounds.lower)
        actions = spaces.Box(-1.0, 1.0, (columns,), dtype=np.float32)
        super().__init__(env.num_envs, env.single_observation_space, actions)
        self._actions = np.zeros((env.num_envs, columns))

    def reset(self) -> np.ndarray:
        """Start all episodes; their observations, (envs, size)."""
        # the seed of `seed()` counts for the first reset alone
        seed, self._seeds = self._seeds[0], [None] * self.num_envs
        return self.env.reset(seed=seed)[0]

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions, (envs, controls) in [-1, 1], for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step all episodes: observations (envs, size), rewards and ends (envs,), what is told."""
        lower, upper = (bound.double().numpy() for bound in self.env.world.robot.bounds)
        controls = lower + 0.5 * (np.clip(self._actions, -1, 1) + 1) * (upper - lower)
        seen, reward, terminated, truncated, told = self.env.step(controls)
        ended = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for row in np.flatnonzero(ended):
            infos[row]["terminal_observation"] = told["final_obs"][row]
            infos[row]["TimeLimit.truncated"] = bool(truncated[row])
            infos[row]["outcome"] = int(told["outcome"][row])
        return seen, reward.astype(np.float32), ended, infos

    def close(self) -> None:
        """Nothing is open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the batch, once per episode asked for."""
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the batch; all episodes share it."""
        setattr(self.env, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the batch, once."""
        answer = getattr(self.env, method_name)(*method_args, **method_kwargs)
        return [answer for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """No episode is wrapped."""
        return [False for _ in self._get_indices(indices)]
