"""Benchmarks of the solvers do their work on small problems."""

import numpy as np
import pytest
import torch

double = pytest.mark.usefixtures("precise")


def test_rows_of_solvers_are_judged_told_and_drawn(script, tmp_path):
    worker, free, table = map(script, ("bench_solver_worker", "bench_solver_free", "bench_solver"))
    problem, rows = worker.PROBLEMS["free"], []
    given = problem.instances(2, 5)
    for name in ("ours-eager", free.EXACT):
        controls, row = worker.measure_ours(name, *given, 5, 0.0, problem)
        costs = problem.true_cost(*given, controls).tolist()
        rows.append(row | {"solver": name, "batch": 2, "steps": 5, "costs": costs})
    free.judge_gradients(rows)
    table.judge(rows)
    assert rows[0]["error"] < 1e-2
    lines = table.table(rows, ["a note"], "Small:", [("gradient error", ".1e", "error")])
    table.write(tmp_path / "table.md", lines)
    table.plot([row | {"steps": 30} for row in rows], tmp_path / "plot.png")
    assert "| 5 | 2 | ours-eager |" in (tmp_path / "table.md").read_text()
    assert (tmp_path / "plot.png").is_file()


def test_the_memory_of_a_solve(script, monkeypatch):
    memory = script("bench_solver_memory")
    monkeypatch.setattr(memory, "BATCH", 2)
    monkeypatch.setattr(memory, "STEPS", 5)
    assert [memory.measure((unrolled, 2))[0] for unrolled in (False, True)] == [2, 2]


@double
def test_gradients_against_differences(script):
    gradients = script("bench_solver_gradients")
    kind, (vehicle, *_) = gradients.KINDS[1]
    hidden, physical = gradients.differences(kind, vehicle, False)
    assert max(*hidden, *physical.values()) < 1e-4


@double
def test_random_problems_of_the_convergence_table(script, shared):
    convergence = script("bench_solver_convergence")
    share, numbers, *_ = convergence.statuses(convergence.reference(), "P1", torch.float32, 2)
    assert (float(share), numbers) == (1.0, 0)


@double
def test_a_row_of_the_bounded_lqrs(script, shared):
    lqr = script("bench_lqr")
    whole = dict(np.load(shared / "reference/mpc/acados_lqr/reference_test_umax1.npz"))
    few = whole | {name: whole[name][:1] for name in ("x0", "u")}
    found = lqr.ours(few, 0.0, tolerance=1e-12)
    name, _, _, solved, *_ = lqr.row("ours", found, few).split(" | ")
    assert (name, solved) == ("ours", "1")


@double
def test_constrained_drives_are_told_and_differentiated(script, capsys):
    bench = script("bench_constrained")
    drive = bench.problems.drives(1)
    exact = bench.told("Eager", drive, bench.problems.braking(drive), bench.EXACT, None)
    assert "| CONVERGED | 1 |" in capsys.readouterr().out
    assert bench.differences(drive, "goal", exact).max() < 1e-5


def test_operations_of_a_library_are_counted_and_clocks_written(script, monkeypatch):
    library, staged = script("bench_library_profile"), []

    class Staged(Exception):  # noqa: N818, no error
        """The problem is known."""

    def taken(work, *rest):
        staged.append(work.problem)
        raise Staged

    monkeypatch.setattr(library.native, "solved", taken)
    with pytest.raises(Staged):
        library.measure("kbm", 1e9)
    counted = library.operations(staged[0])
    assert set(counted) == set(library.PARTS)
    assert min(counted.values()) > 0
    written = library.clocked(library.source)(staged[0], "solve", "float")
    assert "DMMV_CLOCK" in written


@pytest.mark.slow
def test_decisions_are_timed(script, monkeypatch, capsys):
    bench = script("bench_closed_loop")
    verdict = bench.ExactVerdict
    monkeypatch.setattr(bench, "ExactVerdict", lambda limit_s: verdict(0.5))
    bench.measure("kbm", 1, 1)
    assert capsys.readouterr().out.endswith("| 100% | 2 |\n")
