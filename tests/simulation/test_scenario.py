"""Scenarios against the recorded starts, and their refusals."""

import re

import numpy as np
import pytest
from hydra.utils import instantiate
from omegaconf import OmegaConf

from diffstack_mmv.simulation import CircleCrossing, SquareCrossing, crossings
from diffstack_mmv.simulation.phases import generator
from diffstack_mmv.simulation.vacancy import Taken

RECORDINGS = [
    f"{scenario}_crossing_{size}"
    for scenario in ("circle", "square")
    for size in ("h5_dt025_cases000-099", "h10_dt025_cases000-049", "h20_dt025_cases000-049")
] + ["circle_crossing_h20_r6_dt025_cases000-049"]
BOTH = pytest.mark.parametrize(
    "scenario", [CircleCrossing(), SquareCrossing()], ids=["circle", "square"]
)


@pytest.mark.parametrize("name", RECORDINGS)
def test_cases_start_as_recorded_after_as_many_draws(recording, scenario_of, name):
    recorded = recording(name)
    radius = float(recorded["circle_radius"])
    scenario = scenario_of(name, humans=recorded["start"].shape[1], circle_radius_m=radius)
    for row, case in enumerate(recorded["cases"]):
        random = generator("test", int(case))
        pedestrians = scenario.sample(random).pedestrians
        assert np.allclose(pedestrians.position.numpy(), recorded["start"][row], rtol=0, atol=1e-12)
        assert np.allclose(pedestrians.goal.numpy(), recorded["goals"][row], rtol=0, atol=1e-12)
        assert random.random_sample() == recorded["rng_next"][row]


@BOTH
def test_drawing_a_case_leaves_the_global_generator_alone(scenario):
    np.random.seed(5)
    expected = np.random.random()
    np.random.seed(5)
    scenario.case("test", 3)
    assert np.random.random() == expected


@BOTH
def test_cases_of_a_batch_equal_the_single_ones(scenario):
    batch = scenario.cases("val", (4, 9))
    assert (batch.pedestrians.position[1] == scenario.case("val", 9).pedestrians.position).all()
    assert batch.robot_heading.shape == (2,)


@BOTH
def test_nobody_touches_anybody_at_the_start(scenario):
    scene = scenario.cases("train", range(20))
    offset = scene.pedestrians.position[:, :, None] - scene.pedestrians.position[:, None]
    distance = offset.norm(dim=-1) + 9 * np.eye(5)
    assert (distance >= 0.8 - 1e-12).all()


@pytest.mark.parametrize("name", ["circle_crossing", "square_crossing", "dense_circle_crossing"])
def test_every_scenario_of_the_configuration_builds_and_draws_a_case(root, name):
    scenario = instantiate(OmegaConf.load(root / "configs" / "scenario" / f"{name}.yaml"))
    assert scenario.case("test", 1).pedestrians.position.shape == (scenario.humans, 2)


def test_phases_do_not_share_seeds():
    states = [generator(phase, 0).get_state()[1][0] for phase in ("train", "val", "test")]
    assert len(set(states)) == 3


@pytest.mark.parametrize("case", [-1, 1000])
def test_a_case_out_of_range_is_refused(case):
    with pytest.raises(ValueError, match=rf"`case` must lie in \[0, 999\], but got {case}"):
        CircleCrossing().case("test", case)


def test_an_unknown_phase_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="`phase` must be one of test, train, val"):
        CircleCrossing().case("exam", 0)


@pytest.mark.parametrize(("family", "humans"), [(CircleCrossing, 40), (SquareCrossing, 170)])
def test_too_many_pedestrians_are_refused_after_a_bounded_search(monkeypatch, family, humans):
    monkeypatch.setattr(crossings, "MAX_TRIES", 300)
    with pytest.raises(ValueError, match=f"`humans` must fit into the scenario.*got {humans}"):
        family(humans=humans).case("test", 0)


@pytest.mark.parametrize("humans", [26, 42])
def test_who_finds_no_place_on_a_full_circle_is_refused_without_a_long_search(monkeypatch, humans):
    """All the millions of draws would take minutes, and find nothing."""
    judged, room = [], Taken.room
    monkeypatch.setattr(Taken, "room", lambda *given: judged.append(len(given[1])) or room(*given))
    told = "`humans` must fit into the scenario, which has no place for pedestrian 26, "
    told += f"but got {humans}. Take scenario.humans=25 at most, or a larger "
    told += "scenario.circle_radius_m than 4. This was case 3 of phase 'test'."
    with pytest.raises(ValueError, match=f"^{re.escape(told)}$"):
        CircleCrossing(humans=humans).case("test", 3)
    assert sum(judged) < 200_000


@pytest.mark.parametrize("case", range(3))
def test_a_place_is_called_missing_only_where_no_draw_finds_one(monkeypatch, case):
    monkeypatch.setattr(crossings, "MAX_TRIES", 100_000)
    searched = crossings.first_accepted

    def without_doubt(random, numbers, accepted, most, possible):
        before = random.get_state()
        found = searched(random, numbers, accepted, most, possible)
        random.set_state(before)
        whole = searched(random, numbers, accepted, most)
        assert (found is None) == (whole is None)
        return whole

    monkeypatch.setattr(crossings, "first_accepted", without_doubt)
    with pytest.raises(ValueError, match="no place for pedestrian"):
        CircleCrossing(humans=16, circle_radius_m=1.5).case("val", case)


@pytest.mark.parametrize("family", [CircleCrossing, SquareCrossing])
def test_more_pedestrians_than_there_is_room_for_are_refused_without_a_search(family):
    with pytest.raises(ValueError, match="`humans` must fit into the scenario, in which at most"):
        family(humans=200)


@pytest.mark.parametrize(
    "sizes",
    [
        {"circle_radius_m": 1.5},
        {"circle_radius_m": 8.0, "pedestrian_speed_mps": 0.01},
        {"circle_radius_m": 0.4, "pedestrian_speed_mps": 0.1},
    ],
)
def test_a_search_ends_before_there_is_no_room_at_all(monkeypatch, sizes):
    monkeypatch.setattr(crossings, "MAX_TRIES", 30_000)

    def draw_more_and_more():
        for humans in range(1, 40):
            CircleCrossing(humans=humans, **sizes).case("val", 0)

    with pytest.raises(ValueError, match="has no place for pedestrian"):
        draw_more_and_more()


def test_a_place_that_is_hard_to_find_is_found_and_one_that_is_not_there_is_refused(monkeypatch):
    crowded = CircleCrossing(humans=20)
    scene = crowded.case("test", 66)  # the last place is that of the 611,896th draw
    offset = scene.pedestrians.position[:, None] - scene.pedestrians.position
    assert (offset.norm(dim=-1) + 9 * np.eye(20) >= 0.8).all()
    monkeypatch.setattr(crossings, "MAX_TRIES", 1000)
    with pytest.raises(ValueError, match="no place for pedestrian 20.*case 213 of phase 'val'"):
        crowded.case("val", 213)


@BOTH
def test_a_scene_knows_the_numbers_of_its_cases(scenario):
    assert scenario.cases("val", (4, 9)).case_numbers().tolist() == [4, 9]
    assert scenario.case("test", 7).case_numbers().tolist() == 7


def test_a_batch_without_a_case_is_refused():
    with pytest.raises(ValueError, match="^`numbers` must name at least one case"):
        CircleCrossing().cases("test", [])


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("humans", -1),
        ("humans", 2.5),
        ("circle_radius_m", -4.0),
        ("pedestrian_radius_m", 0.0),
        ("robot_radius_m", -0.3),
        ("pedestrian_speed_mps", 0.0),
        ("clearance_m", -0.1),
    ],
)
def test_impossible_sizes_are_refused_by_name(setting, value):
    with pytest.raises(ValueError, match=f"`{setting}` must"):
        SquareCrossing(**{setting: value})


def test_a_square_without_width_is_refused():
    with pytest.raises(ValueError, match="`square_width_m` must be positive"):
        SquareCrossing(square_width_m=0.0)
