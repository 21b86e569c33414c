"""Plans with the default settings of the open loop keep clear of whoever can be avoided."""

from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import OmegaConf

from diffstack_mmv.metrics import collided
from diffstack_mmv.planning import build_problem, predicted_reference
from diffstack_mmv.planning.problem import end_discs
from diffstack_mmv.types import Ego, HeadingOf, Motion, Obstacles

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
STEPS, DT_S, SPEED_MPS = 30, 0.1, 4.0
OFFSETS = torch.linspace(0, 1.5, 7)
RADII = torch.tensor([0.25, 0.4, 0.6])


@pytest.fixture(scope="module", params=["unicycle", "kbm"])
def planner(request):
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        arguments = ["data.cache=none", "out=none", f"dynamics={request.param}"]
        config = compose("train", arguments, return_hydra_config=True)
    HydraConfig.instance().set_config(config)
    OmegaConf.set_struct(config, False)
    config.pop("hydra")
    OmegaConf.resolve(config)
    return instantiate(config.stack).planner


# how somebody moves across, and by how much each component of the forecast errs, m/s
SITUATIONS = {
    "standing": (0.0, (0.0, 0.0, 0.0)),
    "walking left": (1.0, (0.0, 0.0, 0.0)),
    "walking right": (-1.3, (0.0, 0.0, 0.0)),
    "predicted": (1.0, (0.0, 0.3, -0.2)),
}
EACH = len(OFFSETS) * len(RADII)


def crossing(errors=True):
    """A bicycle at 4 m/s towards its goal, and agents of three sizes at every offset of its path.

    They stand 6 m ahead, or reach their place there, walking across, when the bicycle does. One
    batch of all situations, `EACH` problems after another; what is true has no errors.
    """
    offset, radius = (part.flatten() for part in torch.meshgrid(OFFSETS, RADII, indexing="ij"))
    offset, radius = (part.repeat(len(SITUATIONS)) for part in (offset, radius))
    walk, wrong = (
        torch.tensor(part).repeat_interleave(EACH, 0)
        for part in zip(*SITUATIONS.values(), strict=True)
    )
    count, zero = len(offset), torch.zeros(len(offset))
    velocity = torch.stack([zero + SPEED_MPS, zero], -1)
    motion = Motion(torch.zeros(count, 2), zero, velocity, zero)
    ego = Ego(motion, HeadingOf.COURSE, end_discs(torch.tensor([1.8, 0.6]).expand(count, 2)))
    goal = torch.stack([zero + SPEED_MPS * STEPS * DT_S, zero], -1)
    time = DT_S * torch.arange(STEPS + 1)
    across = offset[:, None] + walk[:, None] * (time - 6.0 / SPEED_MPS)
    across = across[:, None] + errors * wrong[..., None] * time
    place = torch.stack([torch.full_like(across, 6.0), across], -1).unsqueeze(1)
    weight = torch.full((count, 1, wrong.shape[1]), 1 / wrong.shape[1])
    obstacles = Obstacles(place, weight, radius[:, None], torch.ones(count, 1) > 0)
    path = velocity[:, None] * time[1:, None]
    reference = predicted_reference(motion, path, goal, DT_S)
    return build_problem(ego, goal, reference, obstacles)


@pytest.fixture(scope="module")
def planned(planner):
    """Which plans converged, which hit somebody, and which would have without a plan."""
    truth = crossing(errors=False)
    discs, obstacles = truth.ego.discs, truth.obstacles
    coasting = truth.reference, torch.zeros_like(truth.reference[..., 0])
    with torch.no_grad():
        plan = planner(crossing())
    hit = collided(plan.motion.position, plan.motion.heading, discs, obstacles)
    return plan.converged.float(), hit, collided(*coasting, discs, obstacles)


@pytest.mark.parametrize("situation", SITUATIONS)
def test_who_stands_or_walks_in_the_way_is_avoided(planned, situation):
    begin = EACH * list(SITUATIONS).index(situation)
    converged, hit, hit_by_coasting = (part[begin : begin + EACH] for part in planned)
    assert hit_by_coasting.mean() > 0.3
    assert not hit.any()
    assert converged.mean() > 0.9
