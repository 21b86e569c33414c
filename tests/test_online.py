"""A trained stack from Python, outside of any data set."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch

from diffstack_mmv.data import ConvertedCache, WindowSettings, stack_batch
from diffstack_mmv.geometry import motion_from_frame, rotate
from diffstack_mmv.online import OnlineStack
from diffstack_mmv.planning import PredictedGoal, WantedGoal
from diffstack_mmv.stack import DiffStackMMV
from diffstack_mmv.types import Mode
from dmmv_conventions.observed import ObservedAgents
from tests.data.conftest import ToyAgent, write_cache

DT_S, ROWS = 0.1, 41
AGENTS = [
    ToyAgent("me", Mode.BICYCLE, 80, start=(4.0, 7.0, 2.0), yaw_rate=0.2),
    ToyAgent("walker", Mode.PEDESTRIAN, 80, start=(-8.0, 16.0, 0.3), speed=1.2),
    ToyAgent("late", Mode.CAR, 60, first=20, start=(9.0, 12.0, -2.0), speed=2.0, yaw_rate=-0.1),
]


@pytest.fixture(scope="module")
def online():
    return OnlineStack("pretrained")


def observed(turn=0.0, shift=(0.0, 0.0)):
    """The agents at row 40 of their tables, in a world turned and shifted."""
    rows = np.full((len(AGENTS), ROWS, 5), np.nan)
    for number, agent in enumerate(AGENTS):
        table = agent.table()[["x", "y", "vx", "vy", "heading"]].to_numpy()
        rows[number, agent.first :] = table[: ROWS - agent.first]
    place, velocity = (
        rotate(torch.tensor(rows[..., part]), torch.tensor(turn, dtype=torch.float64)).numpy()
        for part in (slice(0, 2), slice(2, 4))
    )
    return ObservedAgents(
        names=tuple(agent.name for agent in AGENTS),
        modes=tuple(agent.mode.label for agent in AGENTS),
        extent=np.tile([1.8, 0.6], (len(AGENTS), 1)),
        position=place + np.array(shift),
        velocity=velocity,
        heading=rows[..., 4] + turn,
        dt_s=DT_S,
    )


def sized(length_m):
    """Sizes of the agents, the second one as long as given."""
    return np.array([[1.8, 0.6], [length_m, 0.6], [1.8, 0.6]])


@pytest.mark.parametrize("goal", [None, (1.0, 13.0)])
def test_a_decision_is_that_of_an_evaluation(online, tmp_path, goal):
    settings = WindowSettings(ego_modes=("bicycle",))
    write_cache(tmp_path, {"only": ("train", AGENTS)})
    opened = ConvertedCache("toy", str(tmp_path)).open("train", settings)
    batch = stack_batch(opened.get_collate_fn()([opened[0]]), settings)
    place, course = batch.frame.position[0].double(), batch.frame.heading[0].double()
    source = PredictedGoal()
    if goal is not None:
        wanted = rotate(torch.tensor(goal, dtype=torch.float64) - place, -course)
        batch, source = batch._replace(goal=wanted[None].float()), WantedGoal()
    with torch.no_grad():
        expected = online.stack.plan(batch, online.stack.predictor.predict(batch), source)
    found = online(observed(), goal)
    motion = motion_from_frame(
        type(found.plan)(*(part[0].double() for part in expected.plan.motion)), place, course
    )
    assert found.names == ("me", "walker", "late")
    assert found.solved == bool(expected.plan.converged)
    torch.testing.assert_close(found.plan.position, motion.position, atol=2e-3, rtol=0)
    weights = expected.forecast.log_weight[0].double()
    torch.testing.assert_close(found.forecast.log_weight, weights, atol=2e-3, rtol=0)


@pytest.mark.parametrize(
    ("goal", "missed_m"), [((-4.9, 15.0), 0.5), ((2000.0, 2500.0), 3000.0)], ids=["near", "far"]
)
def test_a_wish_does_not_change_how_the_ego_moves_now(online, goal, missed_m):
    expected, found = online(observed()).plan, online(observed(), goal)
    for part in ("position", "heading", "velocity"):
        now, then = getattr(found.plan, part)[0], getattr(expected, part)[0]
        torch.testing.assert_close(now, then, atol=1e-5, rtol=0, msg=part)
    end = torch.tensor(goal, dtype=torch.float64)
    torch.testing.assert_close(found.goal, end, atol=1e-3, rtol=0)
    assert found.miss_m == pytest.approx((found.plan.position[-1] - end).norm().item(), abs=1e-3)
    assert found.miss_m > missed_m, "nobody stops at once, or drives on at 1 km/s"
    assert found.plan.velocity.norm(dim=-1).max() < 25.0


@pytest.mark.parametrize("turn", [0.7, -2.0])
def test_the_world_may_be_turned_and_lie_far_away(online, turn):
    shift = (511570.0, 5535358.0)
    here, there = online(observed()), online(observed(turn, shift))
    angle = torch.tensor(turn, dtype=torch.float64)

    def moved(place):
        return rotate(place, angle) + torch.tensor(shift, dtype=torch.float64)

    torch.testing.assert_close(there.plan.position, moved(here.plan.position), atol=2e-3, rtol=0)
    torch.testing.assert_close(there.goal, moved(here.goal), atol=2e-3, rtol=0)
    torch.testing.assert_close(there.controls, here.controls, atol=5e-3, rtol=0)
    # density at the same point of the world
    point = here.forecast.mean[:, 0] + 0.3
    before, after = (
        here.forecast.log_prob(point),
        there.forecast.log_prob(moved(point)),
    )
    torch.testing.assert_close(after, before, atol=0.05, rtol=0)


def test_the_predictor_is_told_the_exact_place_in_a_map_grid(online, monkeypatch):
    told, predict = [], online.stack.predictor.predict
    monkeypatch.setattr(
        online.stack.predictor, "predict", lambda batch: told.append(batch) or predict(batch)
    )
    seen = observed(0.0, (511570.1, 5535358.3))
    online(seen)
    assert told[0].frame.position[0].tolist() == seen.position[0, -1].tolist()


def test_a_plan_goes_to_a_given_goal(online):
    ahead = online(observed()).plan.position[-1]
    goal = ahead + torch.tensor([0.5, -0.4], dtype=torch.float64)
    decided = online(observed(), goal.tolist())
    assert decided.goal.tolist() == pytest.approx(goal.tolist(), abs=1e-3)
    assert (decided.plan.position[-1] - goal).norm() < (ahead - goal).norm() / 2
    assert decided.control_names == ("acceleration", "steer")
    assert decided.controls.shape == (30, 2)


def test_a_stack_may_work_in_double_precision(online):
    exact = OnlineStack("pretrained")
    exact.stack.double()
    found, expected = exact(observed()), online(observed())
    torch.testing.assert_close(found.plan.position, expected.plan.position, atol=2e-3, rtol=0)
    torch.testing.assert_close(found.forecast.mean, expected.forecast.mean, atol=1e-3, rtol=0)


def test_only_the_nearest_count():
    one = OnlineStack("pretrained", neighbors=1)(observed())
    none = OnlineStack("pretrained", radius_m=1.0)(observed())
    assert one.names == ("me", "walker")
    assert none.names == ("me",)
    assert none.forecast.mean.shape[0] == 1


def test_others_come_from_the_nearest_to_the_furthest_in_whatever_order_they_are_given(online):
    whole, order = observed(), [0, 2, 1]
    parts = {name: getattr(whole, name)[order] for name in ("extent", "position", "velocity")}
    names, modes = ([part[index] for index in order] for part in (whole.names, whole.modes))
    mixed = whole._replace(names=names, modes=modes, heading=whole.heading[order], **parts)
    found, expected = online(mixed), online(whole)
    away = [np.linalg.norm(place - whole.position[0, -1]) for place in whole.position[1:, -1]]
    assert away == sorted(away)
    assert found.names == expected.names == whole.names
    assert torch.equal(found.forecast.mean, expected.forecast.mean)
    assert torch.equal(found.plan.position, expected.plan.position)


@pytest.fixture
def told_to_compile(monkeypatch):
    """A stack that is told to compile and does not; and how many agents its planner saw."""
    counts, plan = [], DiffStackMMV.plan

    def counted(self, batch, forecast, source=None):
        counts.append(batch.neighbors_past.mode.shape[1])
        return plan(self, batch, forecast, source)

    monkeypatch.setattr(DiffStackMMV, "compile_kernels", lambda self: None)
    monkeypatch.setattr(DiffStackMMV, "plan", counted)
    return OnlineStack("pretrained", neighbors=5, compiled=True), counts


def test_a_compiled_stack_has_one_shape_for_any_number_of_agents(online, told_to_compile):
    compiled, counts = told_to_compile
    assert counts == [5], "it compiles before the first decision"
    for present in (3, 1, 2):
        seen = observed()
        seen.position[present:, -1] = np.nan
        here, there = online(seen), compiled(seen)
        assert here.names == there.names == ("me", "walker", "late")[:present]
        assert there.forecast.mean.shape[0] == present
        for part in ("mean", "log_weight", "scale_tril"):
            found, expected = (getattr(each.forecast, part) for each in (there, here))
            torch.testing.assert_close(found, expected, atol=1e-4, rtol=0, msg=part)
        torch.testing.assert_close(there.plan.position, here.plan.position, atol=2e-3, rtol=0)
    assert counts[1::2] == [2, 0, 1], "of the other one"
    assert set(counts[2::2]) == {5}


def test_decisions_of_threads_wait_for_one_another(online):
    """Forward derivatives are those of the process: two at once end each other."""
    places = [(10.0 * number, 0.0) for number in range(3)]
    alone = [online(observed(0.0, place)) for place in places]
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(lambda place: online(observed(0.0, place)), places))
    for one, other in zip(alone, together, strict=True):
        torch.testing.assert_close(one.plan.position, other.plan.position, atol=1e-9, rtol=0)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("change", "goal", "told"),
    [
        ({"dt_s": 0.2}, None, "`observed.dt_s` must be 0.1 s, but got 0.2"),
        ({"heading": np.zeros((3, 41))[:2]}, None, r"`observed.heading` must have the shape"),
        ({"extent": np.ones((2, 2))}, None, "`observed.modes, extent` must be of 3 agents"),
        ({"modes": ("car", "car", "car")}, None, "`mode of the ego` must be one that"),
        ({"modes": ("bike", "car", "car")}, None, "`observed.modes` must be one of bicycle"),
        ({"position": np.full((3, 41, 2), np.nan)}, None, "`ego` must be observed now"),
        ({"heading": np.full((3, 41), np.nan)}, None, "`ego` must be observed now"),
        ({"extent": sized(float("nan"))}, None, r"`observed.extent` must be positive.*'walker'"),
        ({"extent": sized(0.0)}, None, r"`observed.extent` must be positive.*\[0.0, 0.6\]"),
        ({"extent": sized(-1.8)}, None, r"`observed.extent` must be positive"),
        ({"extent": sized(float("inf"))}, None, r"`observed.extent` must be positive"),
        ({"heading": np.zeros(())}, None, r"`observed.heading` must have the shape \(3, rows\)"),
        ({"names": ()}, None, "`observed` must hold the ego"),
        ({"dt_s": "0.1"}, None, "`observed.dt_s` must be a number"),
        ({}, "here", "`goal` must be x and y in m, but got 'here'"),
        ({}, ["a", "b"], "`goal` must be x and y in m"),
        ({}, (None, 1.0), "`goal` must be x and y in m"),
        ({}, {}, "`goal` must be x and y in m"),
        ({}, (1.0,), "`goal` must be x and y in m"),
        ({}, (1.0, float("nan")), "`goal` must be x and y in m"),
    ],
)
def test_what_does_not_fit_is_told(online, change, goal, told):
    with pytest.raises(ValueError, match=told):
        online(observed()._replace(**change), goal)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("part", ["velocity", "heading"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_whoever_has_a_position_now_needs_the_rest(online, part, value):
    whole = observed()
    changed = getattr(whole, part).copy()
    changed[1, -1] = value
    told = f"`observed.{part}` must be finite now as the position is.* for agent 'walker'"
    with pytest.raises(ValueError, match=told):
        online(whole._replace(**{part: changed}))
    place = whole.position.copy()
    place[1, -1] = np.nan
    assert online(whole._replace(position=place, **{part: changed})).names == ("me", "late")


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(("number", "name"), [(1, "walker"), (2, "late")])
@pytest.mark.parametrize("axis", [0, 1])
def test_whoever_has_half_a_size_or_half_a_velocity_is_told_by_name(online, number, name, axis):
    whole = observed()
    whole.extent[number, axis] = 0.0
    with pytest.raises(ValueError, match=f"`observed.extent` must be positive.* agent '{name}'"):
        online(whole)
    whole = observed()
    whole.velocity[number, -1, axis] = np.nan
    with pytest.raises(ValueError, match=f"`observed.velocity` must be finite.* agent '{name}'"):
        online(whole)
    whole.position[number, -1, axis] = np.nan
    assert name not in online(whole).names, "half a position is none"


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda whole: None, "`observed` must be ObservedAgents, but got NoneType. Take what"),
        (lambda whole: whole._asdict(), "`observed` must be ObservedAgents, but got dict"),
        (lambda whole: whole._replace(position=[[0.0]]), "`observed.position` .* got list. Write"),
        (lambda whole: whole._replace(extent=torch.ones(3, 2)), "`observed.extent` .* got Tensor"),
        (
            lambda whole: whole._replace(heading=whole.heading.astype(object)),
            "`observed.heading` must be an array of numbers, but got one of object",
        ),
        (lambda whole: whole._replace(modes=(1, 2, 3)), "`observed.modes` must be a tuple of text"),
        (lambda whole: whole._replace(names=None), "`observed.names` must be a tuple of text"),
    ],
)
def test_other_containers_are_refused_by_name(online, change, told):
    with pytest.raises(TypeError, match=told):
        online(change(observed()))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"device": "horse"}, "`device` must be auto, cpu, or a device of this machine"),
        ({"device": "cuda:99"}, "`device` must be auto, cpu, or a device of this machine"),
        ({"neighbors": 2.5}, "`neighbors` must be a whole number"),
        ({"radius_m": None}, "`radius_m` must be positive"),
        ({"checkpoint": None}, "`checkpoint` must be a path, or a name such as pretrained"),
    ],
)
def test_settings_that_cannot_be_are_told(given, told):
    with pytest.raises(ValueError, match=told):
        OnlineStack(**({"checkpoint": "pretrained"} | given))


def test_a_short_history_is_told(online):
    whole = observed()
    short = {name: getattr(whole, name)[:, 1:] for name in ("position", "velocity", "heading")}
    with pytest.raises(ValueError, match="`observed` must have 41 rows, but got 40"):
        online(whole._replace(**short))
