"""Compiled and eager solves agree; a kernel is compiled once per code; failure falls back."""

import logging
from functools import partial

import pytest
import torch
from torch._dynamo.decorators import maybe_mark_dynamic
from torch._dynamo.utils import counters

from diffstack_mmv.control import ILQR, Bounds, ExactCurvature
from diffstack_mmv.control.batch_last import unpack, walk
from diffstack_mmv.control.compilation import (
    Kernel,
    compiled_kernels,
    hidden_tensors,
    kind,
    with_fixed_numbers,
)
from diffstack_mmv.control.shape_polymorphic import ShapePolymorphic
from diffstack_mmv.dynamics import DiffKBM, ExtendedUnicycle, SingleIntegrator
from diffstack_mmv.vehicles import load_vehicle
from tests.control.problems import driving, goal_cost, rate_model, solve


def test_new_closures_of_the_same_code_are_of_one_kind():
    assert kind(rate_model(1.0)) == kind(rate_model(2.0))
    assert kind(rate_model(1.0)) != kind(goal_cost(torch.zeros(2), torch.ones(3)))
    assert kind(torch.nn.ReLU()) == kind(torch.nn.ReLU())


def test_a_kernel_that_does_not_compile_runs_eagerly_with_one_warning(caplog):
    def unsupported(value):
        torch._dynamo.graph_break()
        return value + 1

    kernel = Kernel(unsupported, {})
    with caplog.at_level(logging.WARNING):
        assert [int(kernel(torch.tensor(i))) for i in range(3)] == [1, 2, 3]
    assert len(caplog.records) == 1
    assert "runs eagerly" in caplog.text


@pytest.mark.slow
@pytest.mark.parametrize("limit", [50.0, 1.0])
def test_compiled_solution_and_gradient_equal_the_eager_ones(limit):
    results = []
    for compile in (False, True):
        hidden, box, controls = driving(batch=(16,), limit=limit)
        hidden["weight"].requires_grad_()
        solution = solve(ILQR(compile=compile), hidden, box, controls)
        solution.controls.square().sum().backward()
        results.append((solution.controls.detach(), hidden["weight"].grad))
    torch.testing.assert_close(results[0], results[1], rtol=1e-2, atol=2e-3)


@pytest.mark.slow
def test_new_closures_and_batch_sizes_are_not_compiled_again():
    def once(batch, wheelbase):
        hidden, box, controls = driving(batch=(batch,))
        hidden["wheelbase"] = torch.tensor(wheelbase)
        assert solve(ILQR(compile=True), hidden, box, controls).converged.all()

    once(16, 1.0)
    once(24, 1.1)
    before = counters["stats"]["unique_graphs"]
    once(40, 1.2)
    once(16, 1.3)
    assert counters["stats"]["unique_graphs"] == before


@pytest.mark.parametrize(
    ("dtype", "context"), [(torch.float32, ShapePolymorphic), (torch.float64, with_fixed_numbers)]
)
def test_numbers_belong_to_the_roll_out_in_double_precision_alone(dtype, context):
    problem = rate_model(1.0), goal_cost(torch.zeros(2), torch.ones(3))
    state = torch.zeros(9, 4, dtype=dtype)
    kernels = compiled_kernels(ExactCurvature(), *problem, (4, 2, False, 1, 8), state)
    assert kernels.attempt.context.func is context
    assert kernels.expand.context.func is ShapePolymorphic


def test_a_number_that_changes_keeps_its_digits_in_a_loop():
    def decay(rate):
        return lambda state: rate * (state - rate)

    def rolled(model, state, rows):
        return walk(lambda state, row: (model(state + row), model(state)), state, rows)

    kernel = Kernel(rolled, {}, partial(with_fixed_numbers, 8), varying=False)
    given = torch.rand(3, 9).double(), torch.rand(4, 3, 9).double()
    for rate in (0.1, 0.2):
        found, wanted = kernel(decay(rate), *given), rolled(decay(rate), *given)
        torch.testing.assert_close(found, wanted, rtol=1e-12, atol=1e-15)


def test_concatenation_by_padding_equals_concatenation():
    parts = torch.rand(3, 2), torch.rand(3, 1), torch.rand(3, 4)
    with ShapePolymorphic(8):
        joined = torch.cat(parts, -1)
    assert joined.equal(torch.cat(parts, -1))


@pytest.mark.parametrize(
    "index", [(..., None), (..., None, slice(None)), (..., None, None, slice(None))]
)
def test_dimensions_inserted_one_by_one_are_those_of_the_index(index):
    rows = torch.rand(3, 2, 4)
    with ShapePolymorphic(8):
        wide = rows[index]
    assert wide.equal(rows[index])


@pytest.mark.parametrize("model", [DiffKBM, ExtendedUnicycle, SingleIntegrator])
def test_a_loop_over_steps_of_a_model_serves_every_batch(model):
    graphs = []

    def backend(graph, example):
        graphs.append(graph)
        return graph.forward

    dynamics = model() if model is SingleIntegrator else model(load_vehicle("bicycle"))

    def one(state, control):
        return dynamics(state.movedim(0, -1), control.movedim(0, -1)).movedim(-1, 0)

    def rolled(state, controls):
        def step(state, control):
            following = torch.vmap(one, (1, 1), 1)(state, control)
            return following, following

        return walk(step, state, controls)[1]

    compiled = torch.compile(rolled, backend=backend, fullgraph=True)
    with torch.no_grad(), ShapePolymorphic(8):
        for batch in (64, 32, 12):
            state, controls = torch.rand(4, 8, batch), torch.rand(10, 2, 8, batch)
            for tensor in (state, controls):
                maybe_mark_dynamic(tensor, tensor.dim() - 1)
            compiled(state, controls)
    assert len(graphs) == 1


@pytest.mark.parametrize(("steps", "loops"), [(1, 0), (2, 1)])
def test_a_walk_of_one_step_is_no_loop(steps, loops):
    code = []

    def backend(graph, example):
        code.append(graph.code)
        return graph.forward

    def step(state, row):
        first, _ = unpack(row, (1,), (2,))
        return state + first, 2 * row

    def rolled(state, rows):
        return walk(step, state, rows, reverse=True)

    given = torch.rand(3, 9), torch.rand(steps, 3, 9)
    with ShapePolymorphic(8):
        found = torch.compile(rolled, backend=backend, fullgraph=True)(*given)
    torch.testing.assert_close(found, rolled(*given))
    assert code[0].count("higher_order.scan") == loops


@pytest.mark.parametrize("size", [4, 12])
@pytest.mark.parametrize("cut", [slice(2), slice(1, None), slice(-3, -1), slice(0, 4, 2), slice(0)])
def test_a_slice_by_entries_equals_the_slice(size, cut):
    rows = torch.rand(3, 2, size)
    with ShapePolymorphic(8):
        kept = rows[..., cut]
    assert kept.equal(rows[..., cut])


def test_tensors_of_the_problems_are_found_in_closures_and_those_of_modules_are_not():
    goal, weight, module = torch.ones(5, 2), torch.ones(3), torch.nn.Linear(2, 2)

    def outer(states):
        return goal_cost(goal, weight)(states, module(states))

    found = list(hidden_tensors(outer))
    assert [any(tensor is each for each in found) for tensor in (goal, weight)] == [True, True]
    assert all(tensor is not module.weight for tensor in found)


@pytest.mark.gpu
def test_solves_on_a_gpu():
    hidden, box, controls = driving(batch=(64,))
    there = {name: value.cuda() for name, value in hidden.items()}
    box_there = Bounds(box.lower.cuda(), box.upper.cuda())
    solution = solve(ILQR(), there, box_there, controls.cuda())
    expected = solve(ILQR(), hidden, box, controls)
    torch.testing.assert_close(solution.controls.cpu(), expected.controls, rtol=0, atol=1e-2)
