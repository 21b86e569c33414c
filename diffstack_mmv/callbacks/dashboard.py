"""The layout of the W&B dashboard, built from code."""

from collections.abc import Sequence

from diffstack_mmv.metrics import OPEN_LOOP

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


def build_dashboard(entity: str, project: str, modes: Sequence[str]) -> str:
    """Create the dashboard of a project: losses, scores by mode, solver, gradients, throughput.

    Needs an account, a network and the extra `dashboard`; runs are logged without any of these.

    Args:
        entity: User or team.
        project: Project of the runs.
        modes: Modes of transport to show.

    Returns:
        The address of the saved view.

    Raises:
        ImportError: The extra `dashboard` is not installed.
    """
    try:
        import wandb_workspaces.reports.v2 as panels  # pyright: ignore[reportMissingImports]
        import wandb_workspaces.workspaces as workspaces  # pyright: ignore[reportMissingImports]
    except ImportError as missing:
        raise ImportError(
            "`wandb-workspaces` must be installed to build a dashboard. "
            "Run: pip install 'diffstack_mmv[dashboard]'"
        ) from missing
    layout = dict(PANELS)
    for mode in modes:
        layout[f"Mode: {mode}"] = tuple(f"val/{mode}/{score}" for score in MODE_SCORES)
    sections = [
        workspaces.Section(
            name=name,
            is_open=True,
            panels=[panels.LinePlot(title=panel_title(key), y=[key]) for key in keys],
        )
        for name, keys in layout.items()
    ]
    view = workspaces.Workspace(
        entity=entity, project=project, name="diffstack_mmv", sections=sections
    )
    return view.save().url


def panel_title(key: str) -> str:
    """Title of what is logged under a key; scores have theirs, with unit and origin."""
    *origin, name = key.split("/")
    if name not in OPEN_LOOP:
        return key
    return f"{OPEN_LOOP[name].heading} ({', '.join(origin)})"
