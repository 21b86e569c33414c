"""The sample generator: reproducible, complete, well behaved."""

import hashlib
import json
import shutil
from collections import Counter

import numpy as np
import pytest

from data_converters import (
    ConversionError,
    ConversionSettings,
    ImptcDataset,
    convert,
    generate_sample,
)
from data_converters.imptc.modes import CLASS_MODES
from data_converters.imptc.sample.lights import GREEN, SignalPlan
from data_converters.imptc.sample.routes import LATERAL_LIMIT_MPS2, make_route
from data_converters.imptc.sample.sensor import STEPS_US, master_clock


def digest(folder):
    paths = sorted(p for p in folder.rglob("*") if p.is_file())
    parts = [str(p.relative_to(folder)).encode() + p.read_bytes() for p in paths]
    return hashlib.sha256(b"".join(parts)).hexdigest()


def test_equal_seeds_give_equal_bytes_and_others_do_not(tmp_path):
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        generate_sample(tmp_path / name, seed=seed, sequences=(7,), duration_s=16.0)
    assert digest(tmp_path / "a") == digest(tmp_path / "b") != digest(tmp_path / "c")


def test_a_sequence_does_not_depend_on_the_others(tmp_path):
    generate_sample(tmp_path / "one", seed=1, sequences=(8,), duration_s=16.0)
    generate_sample(tmp_path / "two", seed=1, sequences=(7, 8), duration_s=16.0)
    alone, among = (next((tmp_path / name).glob("0008_*")) for name in ("one", "two"))
    assert digest(alone) == digest(among)


@pytest.mark.slow
def test_the_default_sample_trains_every_two_wheeler_in_every_split(tmp_path):
    generate_sample(tmp_path / "raw")
    report = convert(
        ConversionSettings(ImptcDataset(tmp_path / "raw"), tmp_path / "cache", workers=2)
    )
    for split, modes in report.windows().items():
        for mode in ("bicycle", "scooter", "motorcycle", "pedestrian"):
            assert modes[mode] > 300, (split, mode)
    classes = {mode for modes in report.agents().values() for mode in modes}
    assert classes == {mode.name.lower() for mode in CLASS_MODES.values()}


@pytest.mark.parametrize("mode", ["bicycle", "scooter", "motorcycle"])
def test_every_two_wheeler_has_windows_in_every_split(converted, mode):
    totals = json.loads((converted / "conversion_report.json").read_text())["totals"]
    windows = {split: modes[mode] for split, modes in totals["windows_4s_3s"].items()}
    assert set(windows) == {"train", "val", "test"}
    assert min(windows.values()) > 30


@pytest.mark.parametrize("mode", ["bicycle", "motorcycle"])
@pytest.mark.parametrize(("direction", "noise"), [("along_m", 0.08), ("across_m", 0.05)])
def test_the_residual_of_the_smoother_is_the_noise_that_was_put_in(
    converted, mode, direction, noise
):
    totals = json.loads((converted / "conversion_report.json").read_text())["totals"]
    assert totals["smoother_residual"][mode][direction] == pytest.approx(noise, rel=0.15)


def test_files_are_spelled_in_different_ways(tmp_path):
    generate_sample(tmp_path, seed=0, sequences=(0, 1), duration_s=16.0)
    kinds = Counter()
    for path in tmp_path.glob("*/vrus/*/track.json"):
        content = json.loads(path.read_text())
        kinds[type(next(iter(content["track_data"].values()))["ts"]).__name__] += 1
        kinds.update(key for key in ("length", "lenght") if key in content["overview"])
        kinds["ts_0"] += "ts_0" in content["track_data"]
    assert min(kinds[kind] for kind in ("int", "str", "length", "lenght", "ts_0")) > 0


@pytest.mark.parametrize("leave", [1, 2, 3])
@pytest.mark.parametrize("offset", [1.9, 4.4, -8.5])
def test_a_route_leads_from_its_arm_to_the_other_within_the_lateral_limit(leave, offset):
    route = make_route(0, leave, offset, reach_m=40.0, box_m=11.0)
    start, end = route.points[0], route.points[-1]
    assert np.hypot(*start) == pytest.approx(np.hypot(40.0, offset), abs=0.2)
    arm = np.array([np.cos(leave * np.pi / 2), np.sin(leave * np.pi / 2)])
    assert end @ arm == pytest.approx(40.0, abs=0.2)
    lateral = route.speed_limit**2 * np.abs(np.gradient(route.heading, 0.1))
    assert np.percentile(lateral[5:-5], 99) < 2.0 * LATERAL_LIMIT_MPS2


def test_crossing_arms_are_never_green_together():
    plan = SignalPlan(offset_s=3.0)
    states = np.array([plan.state(np.array([0, 1, 2, 3]), t) for t in np.arange(0.0, 60.0, 0.2)])
    green = states == GREEN
    assert green.any(axis=0).all()
    assert not (green[:, 0] & green[:, 1]).any()
    np.testing.assert_array_equal(green[:, 0], green[:, 2])


def test_the_clock_steps_by_forty_milliseconds_with_jitter():
    clock = master_clock(2000, 10**15, np.random.default_rng(0))
    assert set(np.diff(clock)) == set(STEPS_US)
    assert np.diff(clock).mean() == pytest.approx(40_000, abs=20)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"duration_s": 10.0}, "duration_s"),
        ({"sequences": (10_000,)}, "sequences"),
        ({"sequences": (3, -1)}, "-1"),
        ({"sequences": (3, 3)}, "once"),
    ],
)
def test_impossible_samples_are_refused_before_anything_is_written(tmp_path, options, says):
    with pytest.raises(ConversionError, match=says):
        generate_sample(tmp_path, **options)
    assert not list(tmp_path.iterdir())


def test_an_existing_sample_is_not_overwritten(tmp_path):
    generate_sample(tmp_path, sequences=(3,), duration_s=16.0)
    before = digest(tmp_path)
    with pytest.raises(ConversionError, match="out.*0003_"):
        generate_sample(tmp_path, seed=9, sequences=(3,), duration_s=16.0)
    assert digest(tmp_path) == before


def test_a_sequence_appears_when_it_is_complete(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("data_converters.imptc.sample.generate.write_context", full)
        with pytest.raises(OSError, match="No space left"):
            generate_sample(tmp_path, sequences=(3,), duration_s=16.0)
    assert not list(tmp_path.iterdir())
    killed = tmp_path / ".partial_0003_20230322_083006" / "vrus"
    killed.mkdir(parents=True)
    (made,) = generate_sample(tmp_path, sequences=(3,), duration_s=16.0)
    assert list(tmp_path.iterdir()) == [made]


def test_the_command_given_again_writes_what_is_missing(succeed, tmp_path):
    given = ["sequences=[7,203]", "duration_s=16", f"out={tmp_path}"]
    succeed("generate_sample", *given)
    first, second = sorted(tmp_path.glob("0*"))
    assert (first.name[:4], second.name[:4]) == ("0007", "0203")
    before = digest(second)
    (first / "kept").touch()
    shutil.rmtree(second)
    assert "Wrote 1 sequences" in succeed("generate_sample", *given)
    assert digest(second) == before
    assert (first / "kept").exists()


@pytest.mark.parametrize(
    ("earlier", "then"),
    [
        (["seed=0 sequences=[7]"], "seed=1 sequences=[7]"),
        (["seed=0 sequences=[7]"], "seed=0 sequences=[7] duration_s=17"),
        (["seed=0 sequences=[7]", "seed=1 sequences=[8]"], "seed=1 sequences=[7,8]"),
    ],
)
def test_sequences_of_other_words_are_not_taken_for_those_of_the_command(
    succeed, refusal, tmp_path, earlier, then
):
    for words in earlier:
        succeed("generate_sample", "duration_s=16", *words.split(), f"out={tmp_path}")
    told = refusal("generate_sample", "duration_s=16", *then.split(), f"out={tmp_path}")
    assert "`out` must not hold the sequence yet, but got 0007_" in told


@pytest.mark.parametrize(
    ("setting", "named"),
    [
        ("sequences=[12345]", "sequences"),
        ("sequences=[seven]", "sequences"),
        ("sequences=[]", "sequences"),
        ("duration_s=5", "duration_s"),
    ],
)
def test_the_command_refuses_what_is_no_sequence(refusal, tmp_path, setting, named):
    assert f"`{named}`" in refusal("generate_sample", setting, f"out={tmp_path / 'raw'}")
