"""Whole recordings are dealt, reproducibly, and none of the splits stays empty."""

from hashlib import sha256

import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_converters import ConversionError, RecordingSplit


@given(st.dictionaries(st.text(min_size=1), st.integers(1, 10**6), min_size=3, max_size=30))
def test_every_recording_is_dealt_and_no_split_is_empty(sizes):
    dealt = RecordingSplit().deal(sizes)
    assert list(dealt) == list(sizes)
    assert set(dealt.values()) == {"train", "val", "test"}
    assert dealt == RecordingSplit().deal(dict(reversed(sizes.items())))


@pytest.mark.parametrize("shares", [(0.34, 0.33, 0.33), (0.2, 0.2, 0.6), (0.4, 0.6, 0.0)])
def test_a_recording_that_is_most_of_all_leaves_no_split_empty(shares):
    wanted = {name for name, share in zip(("train", "val", "test"), shares, strict=True) if share}
    for salt in map(str, range(20)):
        dealt = RecordingSplit(shares, salt).deal({"a": 500, "b": 2, "c": 1, "d": 1})
        assert set(dealt.values()) == wanted


def test_shares_hold_where_recordings_are_many():
    dealt = list(RecordingSplit().deal(dict.fromkeys(map(str, range(1000)), 1)).values())
    assert [dealt.count(split) for split in ("train", "val", "test")] == [700, 150, 150]


def test_another_salt_deals_the_recordings_otherwise():
    sizes = dict.fromkeys(map(str, range(100)), 1)
    plain, salted = RecordingSplit().deal(sizes), RecordingSplit(salt="a").deal(sizes)
    assert plain != salted
    assert salted == RecordingSplit(salt="a").deal(sizes)


@pytest.mark.parametrize("salt", ["x", "z", "c"])
def test_recordings_are_dealt_by_the_middle_of_their_size_in_the_order_of_their_hash(salt):
    sizes = {str(number): float(1 + number % 7) for number in range(40)}
    order = sorted(sizes, key=lambda name: sha256(f"{salt}{name}".encode()).hexdigest())
    total, before, expected = sum(sizes.values()), 0.0, {}
    for name in order:
        middle = (before + sizes[name] / 2) / total
        expected[name] = "train" if middle <= 0.5 else "val" if middle <= 0.8 else "test"
        before += sizes[name]
    assert RecordingSplit((0.5, 0.3, 0.2), salt).deal(sizes) == expected


def test_all_recordings_may_be_given_their_splits():
    given = {"a": "test", "b": "val", "c": "train"}
    assert RecordingSplit(given=given).deal(dict.fromkeys("cab", 1)) == given


def test_given_splits_are_kept_and_unknown_names_refused():
    sizes = dict.fromkeys("abcdef", 1)
    assert RecordingSplit(given={"a": "test", "b": "test"}).deal(sizes)["a"] == "test"
    with pytest.raises(ConversionError, match="`given` must name recordings that are there"):
        RecordingSplit(given={"g": "test"}).deal(sizes)


@pytest.mark.parametrize(
    "options", [{"shares": (0.5, 0.2, 0.1)}, {"shares": (1.2, -0.1, -0.1)}, {"given": {"a": "dev"}}]
)
def test_an_impossible_split_is_refused(options):
    with pytest.raises(ConversionError, match="shares|given"):
        RecordingSplit(**options)
