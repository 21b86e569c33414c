"""Which devices this machine has: torch knows, long before Lightning is imported."""

from dmmv_conventions.checks import message, require


def usable_device(name: str) -> str:
    """The device of a name; `auto` is a GPU where there is one.

    Raises:
        ValueError: This machine has no such device.
    """
    import torch

    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        torch.empty(0, device=name)
    except (RuntimeError, AssertionError) as absent:
        told = f"{name!r} ({str(absent).splitlines()[0]})"
        needs, remedy = "be auto, cpu, or a device of this machine", "Give device=auto."
        raise ValueError(message("device", needs, told, "", remedy)) from absent
    return name


def require_accelerator(name: object) -> None:
    """Refuse a GPU that is not there, by Lightning's word for it.

    Raises:
        ValueError: It is "cuda" or "gpu", and this machine has none.
    """
    if name in ("cuda", "gpu"):
        import torch

        here = torch.cuda.is_available() or (name == "gpu" and torch.backends.mps.is_available())
        remedy = "Write trainer.accelerator=cpu, or auto for whatever there is."
        require(here, "trainer.accelerator", "be one of this machine", repr(name), "", remedy)
