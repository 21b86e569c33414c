"""Plans of the first samples, with their pictures, in the log of a training."""

from types import SimpleNamespace

import pytest
from pytorch_lightning.loggers import WandbLogger

from diffstack_mmv.callbacks import PlanTable
from diffstack_mmv.planning import PredictedGoal
from diffstack_mmv.stack import LossWeights
from tests.stack.test_module import batch_of, stack_of

# stand-ins for the trainer of Lightning
pytestmark = pytest.mark.usefixtures("unchecked")


class Told(WandbLogger):
    """Keeps what it is told to log."""

    def __init__(self):
        self.logged = []

    @property
    def experiment(self):
        return SimpleNamespace(log=self.logged.append)


def logged(stack, batch_index=0, epoch=0, sanity_checking=False):
    """What is logged after a batch of the validation, of two samples every third epoch."""
    logger = Told()
    trainer = SimpleNamespace(
        loggers=[logger], current_epoch=epoch, sanity_checking=sanity_checking
    )
    table = PlanTable(samples=2, every_epochs=3)
    table.on_validation_batch_end(trainer, stack, None, batch_of(), batch_index)
    return logger.logged


@pytest.mark.parametrize("epoch", [0, 3])
def test_as_many_samples_as_asked_for_are_shown_with_their_scores_and_pictures(epoch):
    (told,) = logged(stack_of(PredictedGoal()), epoch=epoch)
    assert told["epoch"] == epoch
    assert [row[0] for row in told["plans"].data] == ["bicycle"] * 2
    assert all(0.0 <= score < 1.0 for row in told["plans"].data for score in row[1:3])
    assert all(row[3].image.size[0] > 100 for row in told["plans"].data)


@pytest.mark.parametrize(
    ("given", "planned"),
    [
        ({"batch_index": 1}, 1.0),
        ({"epoch": 2}, 1.0),
        ({"sanity_checking": True}, 1.0),
        ({}, 0.0),
    ],
    ids=["a later batch", "another epoch", "before the training", "a loss without plans"],
)
def test_nothing_is_planned_for_a_picture_out_of_turn(given, planned):
    stack = stack_of(PredictedGoal(), loss=LossWeights(1.0, planned, planned, planned))
    assert logged(stack, **given) == []


@pytest.mark.parametrize("name", ["samples", "every_epochs"])
def test_numbers_below_one_are_refused(name):
    with pytest.raises(ValueError, match=f"`{name}` must be at least 1"):
        PlanTable(**{name: 0})
