"""A device that this machine lacks is refused by name, before anything is loaded onto it."""

import pytest

from diffstack_mmv.device_checks import require_accelerator, usable_device


@pytest.fixture
def gpus(monkeypatch):
    """Says which kinds of GPU there are."""

    def there(cuda=False, mps=False):
        monkeypatch.setattr("torch.cuda.is_available", lambda: cuda)
        monkeypatch.setattr("torch.backends.mps.is_available", lambda: mps)

    return there


@pytest.mark.parametrize(("cuda", "chosen"), [(True, "cuda"), (False, "cpu")])
def test_auto_is_a_gpu_where_there_is_one(gpus, cuda, chosen):
    gpus(cuda)
    assert usable_device("auto") == chosen


@pytest.mark.parametrize("name", ["cpu", "meta"])
def test_a_device_that_is_there_is_itself(name):
    assert usable_device(name) == name


@pytest.mark.parametrize("name", ["horse", "cpu:x", "cuda:99"])
def test_a_device_that_is_not_there_is_named(name):
    with pytest.raises(ValueError, match=f"`device` must be auto, cpu.* but got '{name}'"):
        usable_device(name)


@pytest.mark.parametrize(("name", "cuda", "mps"), [
    ("cuda", True, False), ("gpu", True, False), ("gpu", False, True),
    ("cpu", False, False), ("auto", False, False), (None, False, False),
])  # fmt: skip
def test_an_accelerator_that_is_there_is_admitted(gpus, name, cuda, mps):
    gpus(cuda, mps)
    require_accelerator(name)


@pytest.mark.parametrize(("name", "mps"), [("cuda", False), ("cuda", True), ("gpu", False)])
def test_a_gpu_that_is_not_there_is_refused(gpus, name, mps):
    gpus(False, mps)
    with pytest.raises(ValueError, match=f"`trainer.accelerator` must be .* but got '{name}'"):
        require_accelerator(name)
