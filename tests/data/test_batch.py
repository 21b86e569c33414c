"""From trajdata's batch to a `StackBatch`."""

import pytest
import torch

from diffstack_mmv.data import ConvertedCache, WindowSettings, stack_batch
from diffstack_mmv.data.motions import yaw_rate
from diffstack_mmv.geometry import wrap_angle
from diffstack_mmv.types import Mode

from .conftest import ToyAgent, write_cache


def read(folder, agent, settings=None):
    settings = settings or WindowSettings(ego_modes=(agent.mode.label,))
    write_cache(folder, {"only": ("train", [agent])})
    opened = ConvertedCache("toy", str(folder)).open("train", settings)
    return stack_batch(opened.get_collate_fn()([opened[0]]), settings)


def test_the_ego_is_the_origin_of_its_own_frame_at_the_present(source, windows):
    opened = source.open("train", windows)
    batch = stack_batch(opened.get_collate_fn()([opened[i] for i in range(0, 60, 7)]), windows)
    assert batch.ego_past.motion.position[:, -1].abs().max() < 1e-5
    assert batch.ego_past.motion.heading[:, -1].abs().max() < 1e-6
    torch.testing.assert_close(batch.goal, batch.ego_future.motion.position[:, -1])


@pytest.mark.parametrize(
    "start",
    [(9.0, 9.0, 3.0), (-4.0, 2.0, -1.0), (511570.123, 5535358.456, 1.0)],
    ids=["near", "behind", "map grid"],
)
def test_the_frame_is_told_in_the_world(tmp_path, start):
    agent = ToyAgent("a", Mode.BICYCLE, 80, start=start, yaw_rate=0.3)
    frame, table = read(tmp_path, agent).frame, agent.table().iloc[40]
    torch.testing.assert_close(frame.position[0].tolist(), [table.x, table.y], atol=1e-6, rtol=0)
    turn = wrap_angle(frame.heading - table.heading)
    assert turn.abs().max() < 1e-9
    assert frame.known.all()


def test_shapes_are_those_of_the_settings(source, windows):
    opened = source.open("train", windows)
    batch = stack_batch(opened.get_collate_fn()([opened[i] for i in (0, 1)]), windows)
    assert batch.ego_past.motion.position.shape == (2, 41, 2)
    assert batch.ego_future.motion.yaw_rate.shape == (2, 30)
    assert batch.neighbors_past.motion.velocity.shape == (2, 3, 41, 2)
    assert batch.neighbors_future.valid.shape == (2, 3, 30)
    assert batch.dt_s == 0.1


@pytest.mark.parametrize("yaw_rate", [0.5, -0.3, 0.0])
def test_a_circle_has_constant_body_velocity_and_yaw_rate(tmp_path, yaw_rate):
    agent = ToyAgent("a", Mode.BICYCLE, 80, start=(9.0, 9.0, 3.0), yaw_rate=yaw_rate)
    batch = read(tmp_path, agent)
    for tracks in (batch.ego_past, batch.ego_future):
        velocity = torch.tensor([3.0, 0.0]).expand_as(tracks.motion.velocity)
        torch.testing.assert_close(tracks.motion.velocity, velocity, atol=1e-5, rtol=0)
        rate = torch.full_like(tracks.motion.yaw_rate, yaw_rate)
        torch.testing.assert_close(tracks.motion.yaw_rate, rate, atol=1e-4, rtol=0)


@pytest.mark.parametrize("mode", [Mode.BICYCLE, Mode.SCOOTER, Mode.TRUCK])
def test_extent_and_mode_are_those_of_the_agent(tmp_path, mode):
    batch = read(tmp_path, ToyAgent("a", mode, 80))
    torch.testing.assert_close(batch.ego_past.extent, torch.tensor([[1.8, 0.6]]))
    assert batch.ego_future.mode.tolist() == [mode]


def test_somebody_alone_has_no_neighbors(tmp_path):
    batch = read(tmp_path, ToyAgent("a", Mode.BICYCLE, 80))
    assert batch.neighbors_past.motion.position.shape == (1, 0, 41, 2)
    assert batch.neighbors_past.mode.shape == (1, 0)
    assert batch.neighbors_past.mode.dtype == torch.int64


@pytest.mark.parametrize("time", ["neighbors_past", "neighbors_future"])
def test_absent_rows_are_zero_and_marked(source, windows, time):
    opened = source.open("train", windows)
    batch = stack_batch(opened.get_collate_fn()([opened[i] for i in range(50)]), windows)
    tracks = getattr(batch, time)
    assert not tracks.valid.all()
    for part in tracks.motion:
        assert part.isfinite().all()
        assert (part[~tracks.valid] == 0).all()


def test_the_past_does_not_depend_on_the_future(tmp_path):
    straight = ToyAgent("a", Mode.BICYCLE, 80, speed=3.0)
    before = read(tmp_path / "straight", straight)

    class Turning(ToyAgent):
        def table(self):
            rows = super().table()
            rows.loc[41:, "heading"] += 0.3
            return rows

    after = read(tmp_path / "turning", Turning("a", Mode.BICYCLE, 80, speed=3.0))
    for old, new in zip(before.ego_past.motion, after.ego_past.motion, strict=True):
        torch.testing.assert_close(old, new)
    assert not torch.equal(before.ego_future.motion.yaw_rate, after.ego_future.motion.yaw_rate)


HALF_TURN = [3.0, 3.1, 3.2 - 2 * torch.pi, 3.3 - 2 * torch.pi]


@pytest.mark.parametrize(
    ("heading", "moving", "expected"),
    [
        ([0.0, 0.0, 1.0, 1.1, 1.2], [0, 0, 1, 1, 1], [0.0, 0.0, 1.0, 1.0, 1.0]),
        (HALF_TURN, [1, 1, 1, 1], [1.0, 1.0, 1.0, 1.0]),
        ([0.0, 0.1, 0.3, 0.3], [1, 1, 1, 1], [1.0, 1.5, 1.0, 0.0]),
        ([0.0, 3.0], [1, 1], [4.0, 4.0]),
    ],
    ids=["jump at standstill", "half a turn", "mean of both sides", "limit"],
)
def test_the_yaw_rate_is_that_of_an_agent_in_motion(heading, moving, expected):
    rate = yaw_rate(torch.tensor(heading), torch.tensor(moving, dtype=torch.bool), 0.1)
    torch.testing.assert_close(rate, torch.tensor(expected), atol=1e-5, rtol=0)
