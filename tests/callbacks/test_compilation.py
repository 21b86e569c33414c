"""The solver is compiled where a training is long enough."""

import types

import pytest

from diffstack_mmv.callbacks import CompiledSolver

# stand-ins for the trainer and the module of Lightning
pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.mark.parametrize(("steps", "compiled"), [(49, 0), (50, 1), (float("inf"), 1)])
def test_only_a_long_training_is_compiled(steps, compiled):
    calls = []
    trainer = types.SimpleNamespace(estimated_stepping_batches=steps)
    stack = types.SimpleNamespace(
        compile_kernels=lambda: calls.append("kernels"),
    )
    CompiledSolver(50).on_train_start(trainer, stack)
    assert calls == ["kernels"] * compiled
