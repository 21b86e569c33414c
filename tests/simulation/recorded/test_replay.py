"""People who walk as recorded: exactly so, and without a word about the future."""

from types import SimpleNamespace

import pytest
import torch

from diffstack_mmv.prediction import ConstantVelocity
from diffstack_mmv.simulation import (
    ConstantVelocityForecaster,
    ExactVerdict,
    HolonomicRobot,
    KnownFuture,
    LearnedForecaster,
    OrcaCrowd,
    OrcaPolicy,
    ReplayCrowd,
    World,
    drive,
)
from diffstack_mmv.simulation.crossings import CircleCrossing
from diffstack_mmv.types import map_tensors
from tests.simulation.test_forecasters import paths


@pytest.fixture
def world():
    return World(HolonomicRobot(), ReplayCrowd(), ExactVerdict(8.0))


def stepped(world, scene, steps, action=0.3):
    """States at every step, the robot always moving the same way."""
    states = [world.start(scene)]
    for _ in range(steps):
        last = states[-1]
        states.append(world.step(last, torch.full_like(last.goal, action)).state)
    return states


def without_future(scene, rows):
    """The same scene, in which another future follows `rows` after the start."""
    crowd = scene.pedestrians
    first = int(crowd.lead.reshape(-1)[0]) + rows + 1
    track, inside = crowd.track.clone(), crowd.inside.clone()
    track[..., first:, :] = track[..., first:, :].flip(-1) + 3.0
    inside[..., first:] = inside[..., first:].flip(-1)
    return scene._replace(pedestrians=crowd._replace(track=track, inside=inside))


def test_everybody_is_where_the_recording_says(world, crossing):
    scene = crossing().cases("test", range(3))
    crowd = scene.pedestrians
    for ahead, state in enumerate(stepped(world, scene, 20)):
        row = int(crowd.lead[0]) + ahead
        seen, now = crowd.inside[..., row], state.pedestrians
        assert torch.equal(now.present, seen)
        assert torch.allclose(now.position[seen], crowd.track[..., row, :][seen], atol=1e-9)
        walked = (crowd.track[..., row, :] - crowd.track[..., row - 1, :])[seen] / 0.25
        assert torch.allclose(now.velocity[seen], walked, atol=1e-9)
        assert (now.position[~seen].abs() > 500).all()
        assert (now.velocity[~seen] == 0).all()


def test_people_appear_and_leave(world, crossing):
    states = stepped(world, crossing().cases("test", range(3)), 24)
    there = torch.stack([state.pedestrians.present for state in states])
    appeared = (there[1:] & ~there[:-1]).any()
    left = (~there[1:] & there[:-1]).any()
    assert appeared
    assert left
    assert all(world.clearance(state).isfinite().all() for state in states)


@pytest.mark.parametrize("steps", [0, 5])
def test_nothing_that_is_to_come_is_seen(world, crossing, steps):
    scene = crossing().cases("test", range(2))
    forecasters = [LearnedForecaster(ConstantVelocity(30, 0.1), 2.0), ConstantVelocityForecaster()]
    told = []
    for each in (scene, without_future(scene, steps)):
        seen = [world.observe(state) for state in stepped(world, each, steps)]
        action = OrcaPolicy().act(None, seen[-1]).action
        told.append((seen, action, [paths(forecaster, *seen) for forecaster in forecasters]))
    leaves = [torch.utils._pytree.tree_leaves(each) for each in told]
    assert len(leaves[0]) == len(leaves[1]) > 10
    tensors = [pair for pair in zip(*leaves, strict=True) if isinstance(pair[0], torch.Tensor)]
    assert all(torch.equal(*pair) for pair in tensors)


def test_what_was_seen_before_the_start_is_the_recording(world, crossing):
    scene = crossing().cases("test", range(2))
    history, crowd = world.observe(world.start(scene)).history, scene.pedestrians
    assert history.present.shape[-1] == 8
    for row in (2, 7):
        there = crowd.inside[..., row]
        assert torch.equal(history.present[..., row], there)
        assert torch.equal(history.position[..., row, :][there], crowd.track[..., row, :][there])
    assert (history.position[~history.present] == 0).all()


def test_a_predictor_is_shown_the_past_before_the_start(world, crossing):
    class Recorder(ConstantVelocity):
        def forward(self, past, neighbors):
            self.shown = neighbors
            return super().forward(past, neighbors)

    scene = crossing().cases("test", range(2))
    recorder = Recorder(30, 0.25)
    seen = world.observe(world.start(scene))
    paths(LearnedForecaster(recorder, 1.5), seen)
    crowd = scene.pedestrians
    past = crowd.inside[..., 2:9]
    assert torch.equal(recorder.shown.valid, past)
    shown = recorder.shown.motion.position[past]
    assert torch.allclose(shown, crowd.track[..., 2:9, :][past].float(), atol=1e-5)


def test_a_batch_is_its_cases_one_by_one(world, crossing):
    together = drive(world, crossing().cases("test", range(3)), OrcaPolicy()).record
    for case in range(3):
        alone = drive(world, crossing().cases("test", [case]), OrcaPolicy()).record
        end = int(alone.steps[0])
        assert torch.equal(together.outcome[case], alone.outcome[0])
        assert torch.equal(together.steps[case], alone.steps[0])
        pair = together.pedestrians[case, : end + 1], alone.pedestrians[0, : end + 1]
        assert torch.equal(*(each.nan_to_num() for each in pair))
        assert torch.equal(pair[0].isnan(), pair[1].isnan())


def test_the_known_future_is_the_recording(crossing):
    world = World(HolonomicRobot(), ReplayCrowd(), ExactVerdict(8.0), reveals_s=2.0)
    state = world.start(crossing().cases("test", range(2)))
    seen = world.observe(state)
    assert seen.future.shape[-2] == 8  # 2 s in steps of 0.25 s
    path = paths(KnownFuture(), seen, dt_s=0.25, steps=8)[..., 1:, :].squeeze(-3)
    crowd = state.pedestrians
    stays = crowd.present & torch.stack([crowd.inside_after(k) for k in range(1, 9)]).all(0)
    truth = torch.stack([crowd.recorded(k) for k in range(1, 9)], -2)
    assert stays.any()
    assert torch.allclose(path[stays], truth[stays])


@pytest.mark.usefixtures("unchecked")  # an observation of the future alone
@pytest.mark.parametrize(
    ("dt_s", "places"),  # rows of 0, 1, 1 and 3 m, 0.25 s apart
    [(0.375, [1.0, 3.0, 3.0]), (0.25, [1.0, 1.0, 3.0]), (0.125, [0.5, 1.0, 1.0])],
)
def test_the_known_future_is_between_its_rows_and_ends_with_them(dt_s, places):
    along = torch.tensor([[[1.0], [1.0], [3.0]]]) * torch.tensor([1.0, -2.0])
    seen = SimpleNamespace(future=along, pedestrian_position=torch.zeros(1, 2))
    forecast, _ = KnownFuture(0.25)(None, seen, dt_s, 3)
    expected = torch.tensor([places]).unsqueeze(-1) * torch.tensor([1.0, -2.0])
    torch.testing.assert_close(forecast.most_likely(), expected)
    scale = 0.01 * torch.eye(2)
    assert torch.equal(forecast.scale_tril, scale.expand_as(forecast.scale_tril))
    with pytest.raises(ValueError, match="`world_step_s` must be positive"):
        KnownFuture(0.0)


def test_the_future_is_told_only_where_the_world_reveals_it(world, crossing):
    scene = crossing().cases("test", [0])
    seen = world.observe(world.start(scene))
    assert seen.future is None
    with pytest.raises(ValueError, match="`reveals_s` must be positive"):
        paths(KnownFuture(), seen)
    other = World(HolonomicRobot(), OrcaCrowd(), ExactVerdict(8.0), reveals_s=2.0)
    with pytest.raises(ValueError, match="`reveals_s` must be 0 without a recording"):
        other.observe(other.start(CircleCrossing().cases("test", [0])))


@pytest.mark.parametrize(
    ("scenario", "told"),
    [
        (lambda recorded: CircleCrossing(), "`crowd` must have a recording"),
        (lambda recorded: recorded(dt_s=0.5), r"`dt_s` must be the 0\.5 s"),
    ],
    ids=["nothing recorded", "another step"],
)
def test_a_replay_needs_a_recording_of_its_own_step(world, crossing, unchecked, scenario, told):
    start = world.start(scenario(crossing).cases("test", [0]))
    with pytest.raises(ValueError, match=told):
        world.step(start, torch.zeros(1, 2).double())


def test_episodes_of_one_batch_begin_in_one_row(crossing):
    crowd = crossing().cases("test", range(2)).pedestrians
    with pytest.raises(ValueError, match="`lead` must be the same"):
        crowd._replace(lead=torch.tensor([8, 9])).history()


def test_the_scene_can_be_copied_for_a_search(world, crossing):
    scene = crossing().cases("test", [0])
    many = map_tensors(lambda part: part.expand(4, *part.shape[1:]).clone(), scene)
    assert world.step(world.start(many), torch.zeros(4, 2).double()).state.time.shape == (4,)
