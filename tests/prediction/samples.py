"""Random scenes for the tests of predictors."""

import torch

from diffstack_mmv.dynamics import DiffKBM, ExtendedUnicycle, SingleIntegrator
from diffstack_mmv.geometry import rotate, wrap_angle
from diffstack_mmv.prediction import Sizes, Trajectron
from diffstack_mmv.types import Mode, Motion, StackBatch, Tracks
from diffstack_mmv.vehicles import load_vehicle

DT_S = 0.1


def curve(batch, rows, dtype=torch.float32):
    """Agents on gentle curves, each from a random pose."""
    speed = 4 * torch.rand(*batch, 1, dtype=dtype) + 0.5
    yaw_rate = 0.3 * torch.randn(*batch, 1, dtype=dtype)
    time = DT_S * torch.arange(rows, dtype=dtype)
    heading = 6 * torch.rand(*batch, 1, dtype=dtype) + yaw_rate * time
    velocity = torch.stack([speed.expand_as(heading), torch.zeros_like(heading)], -1)
    start = 10 * torch.randn(*batch, 1, 2, dtype=dtype)
    position = start + DT_S * rotate(velocity, heading).cumsum(-2)
    return Motion(position, wrap_angle(heading), velocity, yaw_rate.expand_as(heading))


def split(motion, at, mode):
    def tracks(part):
        cut = Motion(
            *(
                field[(..., part, *(slice(None),) * extra)]
                for field, extra in zip(motion, (1, 0, 1, 0), strict=True)
            )
        )
        extent = torch.tensor([1.8, 0.6], dtype=cut.heading.dtype).expand(*mode.shape, 2)
        return Tracks(cut, extent, mode, torch.ones(cut.heading.shape, dtype=torch.bool))

    return tracks(slice(None, at)), tracks(slice(at, None))


def scene(batch=(3,), neighbors=2, history=21, horizon=10, dtype=torch.float32):
    """A batch of scenes; neighbors alternate between pedestrians and bicycles."""
    ego_mode = torch.full(batch, int(Mode.BICYCLE))
    modes = torch.tensor([int(Mode.PEDESTRIAN), int(Mode.BICYCLE)])
    other_mode = modes[torch.arange(neighbors) % 2].expand(*batch, neighbors)
    ego = split(curve(batch, history + horizon, dtype), history, ego_mode)
    rest = split(curve((*batch, neighbors), history + horizon, dtype), history, other_mode)
    return StackBatch(*ego, *rest, ego[1].motion.position[..., -1, :], DT_S)


def at_rest(batch):
    """The same agents, never moving."""

    def stopped(tracks):
        motion = tracks.motion
        still = motion.position[..., :1, :].expand_as(motion.position) * 0
        zeros = torch.zeros_like(motion.heading)
        return tracks._replace(motion=Motion(still, zeros, torch.zeros_like(still), zeros))

    return StackBatch(*(stopped(tracks) for tracks in batch[:4]), batch.goal * 0, batch.dt_s)


def bicycle(kinematic=False):
    spec = load_vehicle("bicycle")
    return DiffKBM(spec, DT_S) if kinematic else ExtendedUnicycle(spec, DT_S)


def trajectron(ego_dynamics=None, horizon=10, **options):
    """A small Trajectron++ whose weights are all away from zero, so that nothing cancels."""
    model = Trajectron(
        ego_dynamics or bicycle(),
        ExtendedUnicycle(load_vehicle("motorcycle"), DT_S),
        SingleIntegrator(DT_S),
        horizon_steps=horizon,
        sizes=Sizes(8, 8, 8, 16, dropout=0.0),
        **{"components": 4, "neighbor_components": 3} | options,
    )
    with torch.no_grad():
        for branch in model.branches:
            for head in (
                branch.decoder.mean_head,
                branch.decoder.scale_head,
                branch.decoder.start_head,
            ):
                head.weight.normal_(std=0.1)
    return model
