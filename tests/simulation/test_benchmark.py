"""Benchmarks resume, and tell what the contract asks."""

import time
from dataclasses import replace

import numpy as np
import pytest

from diffstack_mmv.simulation import (
    Campaign,
    Method,
    StraightLine,
    read_chunk,
    summarise,
)
from dmmv_conventions.libraries import libraries_loaded, load

KEYS = {
    "n", "success_rate", "collision_rate", "incomplete_rate", "nav_time_s", "nav_time_all_s",
    "discomfort_frequency", "avg_min_dist_m", "mean_episode_min_dist_m", "cases",
}  # fmt: skip


class Counting:
    """Makes straight drivers and counts them."""

    def __init__(self):
        self.made = 0

    def __call__(self):
        self.made += 1
        return StraightLine(2.5)


@pytest.fixture
def straight(world_with):
    return Method("straight", world_with(exact=True, limit_s=10.0), Counting(), "v=2.5")


def chunks(method, scenario, folder, cases=range(6)):
    return list(Campaign(method, scenario, cases, folder, chunk_size=3).run())


def test_an_interrupted_run_drives_only_what_is_missing(straight, scenario_of, tmp_path):
    next(Campaign(straight, scenario_of("circle"), range(6), tmp_path, chunk_size=3).run())
    assert straight.controller.made == 1
    chunks(straight, scenario_of("circle"), tmp_path)
    assert straight.controller.made == 2


class Building(StraightLine):
    """Loads a library at some decisions, and spends 0.3 s of the processor on each that is new."""

    def act(self, state, observation):
        moment, known = float(observation.time.max()), libraries_loaded()
        if moment in (0.0, 0.25, 1.0):
            load(f"// {moment} s")
        end = time.process_time() + 0.3
        while libraries_loaded() > known and time.process_time() < end:
            pass
        return super().act(state, observation)


def test_what_a_decision_builds_is_not_its_time(straight, scenario_of, tmp_path):
    scenario, building = scenario_of("circle"), replace(straight, controller=lambda: Building(2.5))
    told = chunks(building, scenario, tmp_path / "first")
    assert max(chunk.step_s.max() for chunk in told) < 0.05
    same = chunks(straight, scenario, tmp_path / "second")
    for one, other in zip(told, same, strict=True):
        assert one.record.motion.position.equal(other.record.motion.position)


def test_resumed_results_equal_fresh_ones(straight, scenario_of, tmp_path):
    fresh = summarise(chunks(straight, scenario_of("circle"), tmp_path))
    assert summarise(chunks(straight, scenario_of("circle"), tmp_path)) == fresh


def test_chunks_tell_goal_and_radii_for_pictures_also_when_read_back(
    straight, scenario_of, tmp_path
):
    for _ in range(2):
        first = chunks(straight, scenario_of("circle"), tmp_path)[0]
        assert (first.scene["goal"] == [0.0, 4.0]).all()
        assert (first.scene["radius"] == np.full((3, 5), 0.3)).all()


@pytest.mark.parametrize(
    ("settings", "code", "humans", "told"),
    [
        ("v=3", "1+a", 5, r"`out` must hold episodes of the same settings \(v=3\), but got v=2.5"),
        ("v=2.5", "1+b", 5, r"`out` must hold episodes of the same code \(1\+b\), but got 1\+a"),
        ("v=2.5", "1+a", 3, "`out` must hold episodes of the same settings .*humans=3"),
    ],
)
def test_batches_of_other_settings_or_code_are_never_mixed(
    straight, settings, code, humans, told, scenario_of, tmp_path
):
    first = replace(straight, code="1+a")
    next(Campaign(first, scenario_of("circle"), range(6), tmp_path, chunk_size=3).run())
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    other = replace(first, settings=settings, code=code)
    with pytest.raises(ValueError, match=told):
        chunks(other, scenario_of("circle", humans=humans), tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("cases", [range(998, 1003), range(-1, 2)])
def test_cases_beyond_the_phase_are_refused_before_anything_is_driven(
    straight, cases, scenario_of, tmp_path
):
    with pytest.raises(ValueError, match=r"`case` must lie in \[0, 999\]"):
        Campaign(straight, scenario_of("circle"), cases, tmp_path)


def test_other_settings_are_refused_before_anything_is_driven(straight, scenario_of, tmp_path):
    scenario = scenario_of("circle")
    next(Campaign(straight, scenario, range(6), tmp_path, chunk_size=3).run())
    driven = Campaign(straight, scenario, range(6), tmp_path, 3)
    driven.require_same_origin()
    with pytest.raises(ValueError, match="episodes of the same settings"):
        replace(driven, method=replace(straight, settings="v=3")).require_same_origin()
    assert straight.controller.made == 1


def test_other_cases_of_the_same_settings_may_lie_in_the_folder_those_of_a_phase_not(
    straight, scenario_of, tmp_path
):
    scenario = scenario_of("circle")
    chunks(straight, scenario, tmp_path)
    Campaign(straight, scenario, range(6, 9), tmp_path, 3).require_same_origin()
    with pytest.raises(ValueError, match=r"the same settings \(phase: val\), but got phase: test"):
        Campaign(straight, scenario, range(6, 9), tmp_path, 3, "val").require_same_origin()


@pytest.mark.parametrize(
    ("earlier", "now"),
    [(range(3), range(2)), (range(3), range(1, 4)), (range(2, 5), range(6))],
)
def test_a_batch_that_holds_some_of_the_cases_beside_others_is_in_the_way(
    earlier, now, straight, scenario_of, tmp_path
):
    def campaign(cases):
        return Campaign(straight, scenario_of("circle"), cases, tmp_path, 3)

    [*_] = campaign(earlier).run()
    told = f"hold no other cases in a file .* got cases {earlier[0]} to {earlier[-1]} in .*npz. "
    with pytest.raises(ValueError, match=told + "Choose another `out`, drive those as well, or"):
        campaign(now).require_same_origin()
    campaign(earlier).require_same_origin()


def test_more_cases_take_the_place_of_a_batch_that_was_cut_short(straight, scenario_of, tmp_path):
    for count in (1, 4, 5):
        campaign = Campaign(straight, scenario_of("circle"), range(count), tmp_path, 3)
        campaign.require_same_origin()
        [*_] = campaign.run()
        campaign.remove_parts()
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "test_00000-00002.npz", "test_00003-00004.npz",
    ]  # fmt: skip
    assert straight.controller.made == 4  # the first batch was driven once


def test_what_others_have_made_is_no_part_of_a_batch(straight, scenario_of, tmp_path):
    [*_] = Campaign(straight, scenario_of("square"), range(1), tmp_path, 3).run()
    (tmp_path / "test_00001-00001.npz").write_text("broken")
    campaign = Campaign(straight, scenario_of("circle"), range(3), tmp_path, 3)
    [*_] = campaign.run()
    campaign.remove_parts()
    assert len(list(tmp_path.iterdir())) == 3


def test_a_case_shows_the_thoughts_of_its_own_batch(straight, scenario_of, tmp_path):
    campaigns = [Campaign(straight, scenario_of("circle"), range(3), tmp_path, n) for n in (2, 3)]
    for number, campaign in enumerate(campaigns):
        [*_] = campaign.run()
        for _, file in campaign._files():
            with np.load(file) as stored:
                arrays = dict(stored)
            plan = np.full((len(arrays["cases"]), 1), float(number))
            np.savez(file, **arrays, **{"thoughts.plan": plan})
    assert [campaign.thoughts(1)["plan"].item() for campaign in campaigns] == [0, 1]


def test_batches_of_an_earlier_version_tell_no_code_and_are_refused(
    straight, scenario_of, tmp_path
):
    chunks(straight, scenario_of("circle"), tmp_path)
    for file in tmp_path.iterdir():
        with np.load(file) as stored:
            kept = {name: stored[name] for name in stored.files if "origin" not in name}
        np.savez(file, **kept)
    with pytest.raises(ValueError, match="but got unknown in"):
        chunks(straight, scenario_of("circle"), tmp_path)


def test_a_broken_file_is_made_anew(straight, scenario_of, tmp_path):
    chunks(straight, scenario_of("circle"), tmp_path)
    file = sorted(tmp_path.iterdir())[0]
    file.write_bytes(file.read_bytes()[:100])
    chunks(straight, scenario_of("circle"), tmp_path)
    assert straight.controller.made == 3
    assert read_chunk(file).cases == [0, 1, 2]


def test_episodes_whose_thoughts_are_damaged_are_driven_anew(straight, scenario_of, tmp_path):
    chunks(straight, scenario_of("circle"), tmp_path)
    file, thought = sorted(tmp_path.iterdir())[0], np.full(100, 7.0)
    with np.load(file) as stored:
        np.savez(file, **dict(stored), **{"thoughts.plan": thought})
    file.write_bytes(file.read_bytes().replace(thought.tobytes(), (thought + 1).tobytes()))
    chunks(straight, scenario_of("circle"), tmp_path)
    assert straight.controller.made == 3


def test_the_summary_has_the_keys_of_the_contract(straight, scenario_of, tmp_path):
    told = summarise(chunks(straight, scenario_of("circle"), tmp_path))
    assert set(told) >= KEYS
    assert [case["case"] for case in told["cases"]] == list(range(6))
    rates = told["success_rate"] + told["collision_rate"] + told["incomplete_rate"]
    assert rates == pytest.approx(1.0)


def test_scores_without_a_case_are_none(straight, scenario_of, tmp_path):
    told = summarise(chunks(straight, scenario_of("circle"), tmp_path, cases=[4]))
    assert told["nav_time_s"] is None or np.isfinite(told["nav_time_s"])


def test_no_case_is_refused(straight, scenario_of, tmp_path):
    with pytest.raises(ValueError, match="`cases` must name at least one case"):
        chunks(straight, scenario_of("circle"), tmp_path, cases=[])


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(ValueError, match="`file` must hold episodes"):
        read_chunk(tmp_path / "absent.npz")
