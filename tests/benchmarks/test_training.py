"""Benchmarks of data, models and training do their work on a few windows."""

import socket
from types import SimpleNamespace

import pytest
import torch

from diffstack_mmv.types import map_tensors
from tests.benchmarks.conftest import SCRIPTS

WINDOWS, NEIGHBORS = 4, 1


class Once:
    """In place of the fixture that repeats: calls the work once."""

    def __init__(self):
        self.stats, self.extra_info = {"median": 1.0}, {}

    def __call__(self, work, *given):
        return work(*given)

    def pedantic(self, work, setup=lambda: ((), {}), **rounds):
        given, named = setup()
        return work(*given, **named)


@pytest.fixture
def few(script):
    """A few windows with neighbors."""
    whole = script("bench_training").batch(NEIGHBORS)
    return map_tensors(lambda field: field[:WINDOWS], whole)


@pytest.fixture
def trained(script):
    """A stack that logs nothing, and its optimizer."""
    stack = script("bench_training").stack("unicycle")
    stack.log_dict = stack.log = lambda *given, **named: None
    return stack, torch.optim.SGD(stack.parameters(), 1e-4)


def test_parts_of_a_training_step(script, few, trained):
    parts = script("bench_training")
    for name in ("prediction_forward", "candidates_and_their_scores", "backward_of_all_losses"):
        getattr(parts, f"test_{name}")(Once(), trained[0], few)
    assert any(each.grad is not None for each in trained[0].parameters())


def test_a_step_and_an_evaluation_of_the_throughput(script, few, trained):
    throughput = script("bench_throughput")
    assert throughput.training(*trained, throughput.crowd(few, 2)) > 0
    assert throughput.evaluation(*trained, few) > 0


def test_a_step_is_profiled_and_its_operations_counted(script, few, trained, monkeypatch, tmp_path):
    profile = script("profile_step")
    monkeypatch.setattr(profile, "prepared", lambda *given: (*trained, iter([few])))
    assert "matrix products" in profile.floor([], 0, (1e9, 1e9))
    watch = profile.Watch()
    profile.watched(trained[0], watch)
    with torch.profiler.profile() as profiler:
        torch.ones(2).exp()
    profile.draw(profiler.events(), tmp_path / "chart.png", "title")
    profile.stepped(watch, *trained, few)
    assert {"prediction", "plan", "plan: solver", "backward"} <= set(watch.seconds)
    assert (tmp_path / "chart.png").is_file()


def test_parts_of_the_predictor(script, few, trained, monkeypatch):
    class Windows:
        def __len__(self):
            return WINDOWS

        def __getitem__(self, numbers):
            return few

    predictor = script("bench_predictor")
    monkeypatch.setattr(predictor, "BATCH", WINDOWS)
    monkeypatch.setattr(predictor, "ROUNDS", 1)
    found = predictor.measured(trained[0].predictor, Windows(), 2)
    assert set(found) == {"forward", "forward and backward", "training step", "evaluation"}


def test_a_row_of_the_device_table_with_the_weights_of_the_package(script, few):
    row = script("bench_gpu").row("unicycle", "cpu", False, few, 0.0, ())
    assert all(rate > 0 for rate in row[:2])


def test_a_step_of_a_process_among_others(script, monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS.parent))
    scaling, results = script("benchmarks.bench_scaling"), {}
    made = scaling.stack

    def plain(dynamics):
        stack = made(dynamics)
        stack.compile_kernels = lambda: None
        return stack

    monkeypatch.setattr(scaling, "stack", plain)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    scaling.step_s(0, 1, port, 1, 1, "unicycle", results)
    assert min(results[0]) > 0


def test_the_dynamics_at_their_steps(script, shared, monkeypatch):
    dynamics = script("bench_dynamics")
    monkeypatch.setattr(dynamics, "BATCH", 2)
    dynamics.test_step_of_a_batch(Once(), dynamics.DiffGM3, "bicycle", False)
    _, gradient = dynamics.evaluate("bicycle", dynamics.LIM2(), 1)
    row = dynamics.row("LIM2", dynamics.LIM2(), 1, {"bicycle": gradient})
    assert row.count("|") == dynamics.HEADER.count("|")


def test_readings_of_windows(script, tmp_path, monkeypatch):
    data = script("bench_data")
    monkeypatch.setattr(data, "BATCH", 8)
    data.write_cache(tmp_path / "cache", {"scene_0": ("train", data.crowd())})
    source = data.ConvertedCache("toy", str(tmp_path / "cache"))
    exporting = data.ExportSettings(str(tmp_path / "exports"), progress=False)
    data.test_batches_from_an_export(Once(), source, exporting)
    data.test_samples_straight_from_trajdata_with_the_scene_kept_open(Once(), source)
    data.test_samples_as_trajdata_alone_reads_them(Once(), source)


def test_a_table_of_the_following_errors(script, monkeypatch, capsys):
    table = script("gm3_table_iv")
    error = SimpleNamespace(gm3_m=1.0, kbm_m=2.0)
    monkeypatch.setattr(table, "score", lambda *given: error)
    table.main()
    assert capsys.readouterr().out.count("1.00 / 2.00") == 5 * len(table.VARIANTS)
