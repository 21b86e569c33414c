"""The controller among people who come and go."""

import torch

from diffstack_mmv.simulation import ConstantVelocityForecaster, ExactVerdict, ReplayCrowd, World
from diffstack_mmv.simulation import vehicle_robot


def test_who_is_absent_is_no_obstacle_and_takes_no_room(crossing, controller_for, driven):
    controller = controller_for()
    world = World(vehicle_robot(driven()), ReplayCrowd(), ExactVerdict(8.0))
    seen = world.observe(world.start(crossing(humans=20).cases("test", range(3))))
    dynamics = controller.planner.dynamics
    told = ConstantVelocityForecaster()(None, seen, dynamics.dt_s, controller.planner.steps)
    obstacles = controller.problem(seen, told.forecast).obstacles
    count = seen.pedestrian_present.sum(-1)
    assert obstacles.radius.shape[-1] == int(count.max()) < 20
    assert torch.equal(obstacles.valid.sum(-1), count)
    for case in range(3):
        there = seen.pedestrian_position[case][seen.pedestrian_present[case]].float()
        now = obstacles.position[case][obstacles.valid[case]][:, 0, 0]
        now = now + seen.motion.position[case].float() if now.norm() < 0 else now
        assert now.shape == there.shape
