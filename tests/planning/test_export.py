"""A C program without Python plans with an exported library as the planner does."""

import ctypes
import shutil
import subprocess

import pytest
import torch

from diffstack_mmv.control import ILQR, Batched
from diffstack_mmv.dynamics import DiffGM3, DiffKBM
from diffstack_mmv.planning import PhysicalControls, PlanConstraints, SpeedWithin, initial_state
from diffstack_mmv.planning.export import _example, export_planner
from diffstack_mmv.planning.objective import NAMES, batched_objective, parted
from diffstack_mmv.vehicles import load_vehicle
from dmmv_conventions.libraries import CannotBuildError
from tests.planning.test_planner import problem, training

COMPILER = shutil.which("cc") or shutil.which("gcc")
PROGRAM = """
#include <stdio.h>
#include <string.h>
#include "planner.h"
int main(void) {
  static dmmv_real parameters[DMMV_PARAMETERS];
  dmmv_real state[DMMV_STATES], guess[DMMV_STEPS * DMMV_CONTROLS] = {0};
  dmmv_plan_result plan;
  memcpy(parameters, dmmv_defaults(), sizeof parameters);
  for (int i = 0; i < DMMV_PARAMETERS; ++i)
    if (scanf("%lf", parameters + i) != 1) return 1;
  for (int i = 0; i < DMMV_STATES; ++i)
    if (scanf("%lf", state + i) != 1) return 1;
  int status = dmmv_plan(parameters, state, guess, &plan);
  printf("%d %d\\n", status, plan.iterations);
  for (int t = 0; t < DMMV_STEPS; ++t)
    printf("%.17g %.17g\\n", plan.controls[t][0], plan.controls[t][1]);
  return status != DMMV_CONVERGED;
}
"""


def of_model(model):
    """A planner of a model, in double precision."""
    planner = training().double()
    planner.dynamics = model(load_vehicle("bicycle"), dt_s=0.25).double()
    planner.solver = ILQR(tolerance=1e-10)
    return planner


@pytest.mark.skipif(COMPILER is None, reason="no C compiler is installed")
@pytest.mark.parametrize("model", [DiffKBM, pytest.param(DiffGM3, marks=pytest.mark.slow)])
def test_a_c_program_finds_the_plan_of_the_solver(model, tmp_path):
    """With the learned numbers of a checkpoint."""
    trained = of_model(model)
    with torch.no_grad():
        for parameter in trained.parameters():
            parameter += 0.05
    torch.save(trained.state_dict(), tmp_path / "checkpoint.pt")
    planner = of_model(model)
    planner.load_state_dict(torch.load(tmp_path / "checkpoint.pt", weights_only=True))
    planned = [each.double() if each.is_floating_point() else each for each in flat(problem(1))]
    one = unflat(planned, problem(1))
    written = export_planner(planner, tmp_path, agents=1, components=2)
    cost = batched_objective(planner, planner.dynamics, one, PhysicalControls(planner.dynamics))
    state, guess = (
        initial_state(planner.dynamics, one.ego),
        torch.zeros(1, planner.steps, 2).double(),
    )
    with torch.no_grad():
        expected = planner.solver(
            Batched(planner.dynamics), cost, planner.dynamics.bounds, state, guess
        )
    numbers = parameters(written, dict(zip(NAMES, cost.tensors, strict=True)))
    status, iterations, controls = run_program(tmp_path, torch.cat([numbers, state[0]]))
    assert status == 0
    assert iterations == int(expected.iterations)
    torch.testing.assert_close(controls, expected.controls[0], rtol=1e-9, atol=1e-9)


def flat(record):
    """All tensors of a problem."""
    parts = []
    for each in record:
        parts += (
            [each]
            if isinstance(each, torch.Tensor)
            else flat(each)
            if isinstance(each, tuple)
            else []
        )
    return parts


def unflat(tensors, like):
    """A problem with other tensors."""
    rest = list(tensors)

    def build(record):
        fields = []
        for each in record:
            if isinstance(each, torch.Tensor):
                fields.append(rest.pop(0))
            else:
                fields.append(build(each) if isinstance(each, tuple) else each)
        return type(record)(*fields)

    return build(like)


def parameters(written, values):
    """The defaults of the library with the tensors of a problem in their places."""
    library = ctypes.CDLL(str(written.library))
    library.dmmv_defaults.restype = ctypes.POINTER(ctypes.c_double)
    last = written.entries[-1]
    count = last.offset + torch.Size(last.shape).numel()
    numbers = torch.tensor(library.dmmv_defaults()[:count], dtype=torch.float64)
    for entry in written.entries:
        if entry.name in values:
            value = values[entry.name].double().flatten()
            numbers[entry.offset : entry.offset + value.numel()] = value
    return numbers


def run_program(folder, numbers):
    """Compile the program, link it with the library, and give it the parameters."""
    (folder / "main.c").write_text(PROGRAM)
    command = [COMPILER, "main.c", "-L.", "-lplanner", "-Wl,-rpath,.", "-o", "main"]
    subprocess.run(command, cwd=folder, check=True)
    given = "\n".join(map(repr, numbers.tolist()))
    done = subprocess.run(
        ["./main"], cwd=folder, input=given, capture_output=True, text=True, check=True
    )
    first, *rows = done.stdout.splitlines()
    status, iterations = map(int, first.split())
    controls = torch.tensor([list(map(float, row.split())) for row in rows], dtype=torch.float64)
    return status, iterations, controls


def test_entries_are_named_and_follow_one_another(tmp_path, monkeypatch):
    monkeypatch.setattr("diffstack_mmv.control.native.export.build", lambda *arguments: None)
    written = export_planner(training(), tmp_path, agents=2)
    names = [entry.name for entry in written.entries]
    assert {"goal", "obstacle_position", "cost_log_weight", "dynamics_wheelbase_raw"} <= set(names)
    assert not any(name.startswith("other") for name in names)
    offsets = [entry.offset + torch.Size(entry.shape).numel() for entry in written.entries]
    assert [0, *offsets[:-1]] == [entry.offset for entry in written.entries]
    assert "#define DMMV_AT_GOAL" in written.header.read_text()


def test_an_earlier_library_is_never_beside_the_declarations_of_another(tmp_path, monkeypatch):
    def failing(*arguments):
        raise CannotBuildError("no space")

    (tmp_path / "libplanner.so").write_bytes(b"of other sizes")
    monkeypatch.setattr("diffstack_mmv.control.native.export.build", failing)
    with pytest.raises(CannotBuildError):
        export_planner(training(), tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["planner.cpp", "planner.h"]


@pytest.mark.parametrize("name", ["agents", "components", "discs"])
def test_sizes_are_positive(name, tmp_path):
    with pytest.raises(ValueError, match=f"`{name}` must be at least 1"):
        export_planner(training(), tmp_path, **{name: 0})


def test_a_planner_with_constraints_is_refused(tmp_path):
    planner = training()
    planner.constraints = PlanConstraints({"speed": SpeedWithin()})
    with pytest.raises(ValueError, match="`planner.constraints` must be none"):
        export_planner(planner, tmp_path)


def test_a_processor_that_the_compiler_does_not_know_is_refused_before_anything_is_written(
    tmp_path,
):
    told = "`machine` must be a processor that the C.. compiler builds for, but got 'foo'"
    with pytest.raises(ValueError, match=told):
        export_planner(training(), tmp_path, machine="foo")
    assert not list(tmp_path.iterdir())


def test_a_planner_is_exported_where_it_is():
    example = _example(training().to("meta"), agents=2, components=1, discs=1)
    assert {each.device.type for each in parted(example)} == {"meta"}


def test_more_step_sizes_than_a_library_has_room_for_are_refused(tmp_path):
    planner = training()
    planner.solver = ILQR(line_search_steps=65)
    told = "`solver.line_search_steps` must be at most 64 to export, but got 65"
    with pytest.raises(ValueError, match=told):
        export_planner(planner, tmp_path)
    assert not any(tmp_path.iterdir())
