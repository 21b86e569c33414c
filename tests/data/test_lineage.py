"""What a stack learned from, and whether it is judged on that."""

import pandas as pd
import pytest

from diffstack_mmv.data import (
    joined_recordings,
    other_releases,
    recordings_of,
    require_unseen,
    seen_recordings,
)


def windows(*places):
    return pd.DataFrame(places, columns=["dataset", "scene"])


def test_recordings_are_told_once_by_data_set():
    found = recordings_of(windows(("b", "2"), ("a", "2"), ("b", "1"), ("b", "2")))
    assert found == {"a": ["2"], "b": ["1", "2"]}


def test_what_earlier_trainings_learned_from_is_kept():
    first, second = {"a": ["1", "3"]}, {"a": ["2", "3"], "b": ["1"]}
    assert joined_recordings(first, second) == {"a": ["1", "2", "3"], "b": ["1"]}
    assert joined_recordings({}, second) == second


@pytest.mark.parametrize(
    ("trained", "seen"), [({"b": ["1", "2"]}, ["b/1"]), ({"a": ["2"]}, ["a/2"]), ({}, [])]
)
def test_a_recording_of_the_same_name_in_another_data_set_is_another(trained, seen):
    samples = windows(("a", "1"), ("a", "2"), ("b", "1"))
    assert seen_recordings(samples, trained) == seen


@pytest.mark.parametrize(
    ("judged", "seen"),
    [
        (("eth_ucy_hotel", "biwi_hotel", "biwi_hotel"), ["eth_ucy_hotel/biwi_hotel"]),
        (("eth_ucy_eth", "biwi_hotel_val", "biwi_hotel"), []),
        (("eth_ucy_eth", "biwi_eth", "biwi_eth"), []),
        (("tables_b", "2", "ride"), []),
    ],
    ids=["held out elsewhere", "its own cut", "held out", "of the same name"],
)
def test_what_was_learned_under_another_name_of_the_family_is_seen(judged, seen):
    columns = ["dataset", "scene", "recording"]
    trained = [("eth_ucy_eth", "biwi_hotel_train", "biwi_hotel"), ("tables_a", "1", "ride")]
    learned = recordings_of(pd.DataFrame(trained, columns=columns))
    assert seen_recordings(pd.DataFrame([judged], columns=columns), learned) == seen


@pytest.mark.parametrize(
    ("judged", "told"), [("imptc", ["imptc_vru"]), ("imptc_vru", []), ("sdd", [])]
)
def test_another_release_of_what_was_learned_from_is_named(judged, told):
    learned = {"imptc_vru": ["0001"], "citr": ["1"]}
    assert other_releases(windows((judged, "0003_20230322_081506")), learned) == told


def test_a_split_with_recordings_of_the_training_is_refused_by_their_names():
    require_unseen("split", "test", [])
    seen = [f"a/{number}" for number in range(9)]
    says = r"`split` must.*9 of them in 'test': a/0, .*a/4, \.\.\.\. .*allow_seen=true"
    with pytest.raises(ValueError, match=says):
        require_unseen("split", "test", seen)
