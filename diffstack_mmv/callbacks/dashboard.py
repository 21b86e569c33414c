"""The layout of the W&B dashboard, built from code."""

from collections.abc import Mapping, Sequence
from typing import Any

from diffstack_mmv.metrics import CLOSED_LOOP, OPEN_LOOP
from dmmv_conventions.extras import needs

PANELS: dict[str, tuple[str, ...]] = {
    "Losses": (
        "train/loss",
        "train/prediction",
        "train/planning_ce",
        "train/planning_cost",
        "train/control",
    ),
    "Validation": (
        "val/ade",
        "val/fde",
        "val/nll",
        "val/plan_ade",
        "val/planning_loss",
        "val/collision_rate",
        "val/min_ade",
        "val/miss_rate",
        "val/n_missing",
    ),
    "Solver": ("train/solved", "val/solved"),
    "Gradients": ("gradient/predictor", "gradient/cost", "gradient/dynamics"),
    "Throughput": ("throughput/samples_per_s", "throughput/waiting_share"),
}
MODE_SCORES = ("ade", "nll", "plan_ade", "planning_loss")
LEARNED: dict[str, str] = {"Cost weights": "cost_weight/.*", "Physical parameters": "physical/.*"}
"""Title -> which keys; what they are depends on the cost and on the dynamics of a run."""
RESULTS: dict[str, tuple[str, ...]] = {
    "Closed loop": ("success_rate", "collision_rate", "nav_time_s", "discomfort_frequency"),
    "Identification": ("loss_before", "loss_after", "heldout_before", "heldout_after"),
}
"""Numbers of finished commands, one per run."""


def build_dashboard(entity: str, project: str, modes: Sequence[str]) -> str:
    """Create the dashboard of a project, see `dashboard`.

    Needs an account, a network and the extra `dashboard`; runs are logged without any of these.

    Args:
        entity: User or team.
        project: Project of the runs.
        modes: Modes of transport to show.

    Returns:
        The address of the saved view.

    Raises:
        MissingExtraError: The extra `dashboard` is not installed.
    """
    return dashboard(entity, project, modes).save().url


def dashboard(entity: str, project: str, modes: Sequence[str]) -> Any:
    """Lay out losses, scores by mode, learned values, solver, gradients, throughput and results.

    Args:
        entity: User or team.
        project: Project of the runs.
        modes: Modes of transport to show.

    Returns:
        The workspace of `wandb_workspaces`, which is not saved yet.

    Raises:
        MissingExtraError: The extra `dashboard` is not installed.
    """
    with needs("dashboard", "dmmv-dashboard"):
        import wandb_workspaces.reports.v2 as panels  # pyright: ignore[reportMissingImports]
        import wandb_workspaces.workspaces as workspaces  # pyright: ignore[reportMissingImports]
    content: dict[str, list[Any]] = {
        name: [panels.LinePlot(title=panel_title(key), y=[key]) for key in keys]
        for name, keys in _curves(modes).items()
    }
    content["Learned"] = [
        panels.LinePlot(title=title, metric_regex=keys) for title, keys in LEARNED.items()
    ]
    for name, keys in {"Evaluation": _evaluated(modes), **RESULTS}.items():
        content[name] = [panels.BarPlot(title=panel_title(key), metrics=[key]) for key in keys]
    sections = [
        workspaces.Section(name=name, is_open=True, panels=shown) for name, shown in content.items()
    ]
    return workspaces.Workspace(
        entity=entity, project=project, name="diffstack_mmv", sections=sections
    )


def _curves(modes: Sequence[str]) -> Mapping[str, Sequence[str]]:
    by_mode = {f"Mode: {mode}": [f"val/{mode}/{each}" for each in MODE_SCORES] for mode in modes}
    return PANELS | by_mode


def _evaluated(modes: Sequence[str]) -> Sequence[str]:
    return [f"modes/{mode}/{score}" for mode in modes for score in ("ade", "plan_ade")]


def panel_title(key: str) -> str:
    """Title of what is logged under a key; scores have theirs, with unit and origin."""
    *origin, name = key.split("/")
    known = OPEN_LOOP if origin else CLOSED_LOOP
    if name not in known:
        return key
    return f"{known[name].heading} ({', '.join(origin)})" if origin else known[name].heading
