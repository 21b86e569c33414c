"""What commands need that work: recordings, a cache, a stack, its evaluation. Made once."""

import contextlib
import io
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.utils import instantiate
from omegaconf import OmegaConf

from data_converters import ConversionSettings, ThabVruDataset, convert
from dmmv_conventions.configs import config_folder
from tests.data_converters.synthetic import thab_vru

SHORT = ("history_s=1.0", "horizon_s=1.0", "batch_size=8")
TINY = ("predictor=constant_velocity", "dynamics=kbm", *SHORT)


@cache
def recordings() -> Path:
    """Four rides that wind."""
    folder = Path(mkdtemp()) / "raw"
    thab_vru(folder)
    return folder


@cache
def converted() -> Path:
    """A cache of the rides: one in each split at least."""
    folder = Path(mkdtemp()) / "cache"
    convert(ConversionSettings(ThabVruDataset(recordings()), folder, progress=False))
    return folder


def data() -> list[str]:
    """Arguments that name the cache."""
    return ["data=thab_vru", f"data.cache={converted()}", "data.module.export.workers=0"]


@cache
def checkpoint() -> Path:
    """A stack that was never trained, as a training writes it."""
    path = Path(mkdtemp()) / "last.ckpt"
    torch.save(stack_content(), path)
    return path


def stack_content() -> dict[str, Any]:
    """Configuration and weights of a small stack."""
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("train", [*data(), *TINY, "out=x"], return_hydra_config=True)
        hydra = config.hydra
        hydra.runtime.choices = {**hydra.runtime.choices}
    GlobalHydra.instance().clear()
    plain = OmegaConf.create({key: value for key, value in config.items() if key != "hydra"})
    plain.names = {"dynamics": "kbm", "predictor": "constant_velocity"}
    content: Any = OmegaConf.to_container(plain, resolve=True)
    stack = instantiate(content["stack"])
    return {"provenance": {"config": content}, "state_dict": stack.state_dict()}


def said(script: str, arguments: list[str]) -> str | None:
    """What a command tells before it ends with a failure, None where it works.

    Raises:
        AssertionError: It ends in a traceback.
    """
    main: Callable[[], None] = import_module(f"scripts.{script}").main
    told, before = io.StringIO(), sys.argv
    GlobalHydra.instance().clear()
    try:
        sys.argv = [script, *arguments]
        with contextlib.redirect_stderr(told), contextlib.redirect_stdout(io.StringIO()):
            main()
    except SystemExit as ended:
        if "Traceback" in told.getvalue():
            raise AssertionError(told.getvalue()) from ended
        lines = [line for line in told.getvalue().strip().splitlines() if line.strip()]
        # Hydra repeats the command line before it tells anything
        kept = [line for line in lines if not line.startswith("Error executing job")]
        return "\n".join(kept) if ended.code not in (0, None) else None
    finally:
        sys.argv = before
        GlobalHydra.instance().clear()
    return None


def done(script: str, arguments: list[str]) -> None:
    """Run a command that has to work.

    Raises:
        AssertionError: It does not: what is tried with it would say nothing.
    """
    told = said(script, arguments)
    if told is not None:
        raise AssertionError(f"{script} {' '.join(arguments)} does not work: {told}")


@cache
def evaluated() -> Path:
    """What `evaluate` writes of the stack."""
    out = Path(mkdtemp()) / "report"
    done("evaluate", [*base("evaluate"), f"out={out}"])
    return out


@cache
def simulated() -> Path:
    """What `simulate` writes."""
    out = Path(mkdtemp()) / "drive"
    done("simulate", [*base("simulate"), f"out={out}"])
    return out


@cache
def navigated() -> Path:
    """What `navigate` writes of one case."""
    out = Path(mkdtemp()) / "crowd"
    done("navigate", [*base("navigate"), f"out={out}"])
    return out


def base(script: str) -> list[str]:
    """Arguments with which a command works; `out` is still to be given."""
    return {
        "convert": lambda: [
            f"data.root={recordings()}",
            f"data.cache={Path(mkdtemp()) / 'cache'}",
            "workers=1",
        ],
        "train": lambda: [*data(), *TINY, "epochs=1", "trainer.limit_train_batches=1",
                          "trainer.limit_val_batches=1", "logger=csv"],
        "evaluate": lambda: [*data(), f"checkpoint={checkpoint()}", *SHORT, "plots=false",
                             "wandb=none", "device=cpu", "modes=[bicycle]"],
        "identify": lambda: [*data(), "dynamics=kbm", "others.unicycle=null", "tracks=2", "heldout=1",
                             "starts=0", "wandb=none", "splits=[train,val,test]", "stretch.max_s=3.0",
                             "stretch.min_s=2.0", "tracking.jerk_mps3=1.0", "tracking.curvature_rate=0.1"],
        "compare": lambda: [f"runs=[{evaluated()}]", "wandb=none"],
        "report": lambda: [f"runs=[{evaluated()}]"],
        "results": lambda: ["dry_run=true", f"raw={recordings().parent}"],
        "simulate": lambda: ["others.unicycle=null", "dynamics=kbm"],
        "navigate": lambda: ["cases=1", "wandb=none", "animate=0", "controller=straight", "limit_s=2",
                             "search.samples=8", *[f"baselines.{name}=null"
                                                   for name in ("straight", "blind", "orca", "mppi")]],
        "dashboard": list,
        "generate_sample": list,
        "download_imptc": list,
    }[script]()  # fmt: skip
