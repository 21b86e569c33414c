"""Learning curves and learned parameters of a training, from its CSV log."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from diffstack_mmv.reporting.html.blocks import Chart, Section

LOG = Path("csv") / "metrics.csv"
CURVES = {
    "Loss": ("train/loss", "train/prediction", "train/planning_ce", "train/control"),
    "Validation": ("val/ade", "val/fde", "val/plan_ade", "val/plan_fde", "val/min_ade"),
    "Validation: likelihood and planning loss": ("val/nll", "val/planning_loss"),
    "Validation: shares": ("val/solved", "val/collision_rate", "val/miss_rate"),
}
"""Title of a chart -> columns of the log."""
GROUPS = {
    "Cost weights": "cost_weight/",
    "Physical parameters": "physical/",
    "Gradient norms": "gradient/",
    "Learning rate": "lr-",
}
"""Title of a chart -> what the columns of the log begin with."""


def read_training(folder: Path) -> list[Section]:
    """Learning curves by epoch, validation by mode, and what was learned; none without a log."""
    file = folder / LOG
    if not file.is_file():
        return []
    log = pd.read_csv(file)
    named = log["epoch"].notna() if "epoch" in log else pd.Series(False, index=log.index)
    log = log[named].groupby("epoch", as_index=False).last()
    charts = [_chart(title, log, columns) for title, columns in CURVES.items()]
    by_mode = [name for name in log.columns if name.startswith("val/") and name.count("/") == 2]
    for score in ("ade", "plan_ade", "planning_loss"):
        columns = [name for name in by_mode if name.endswith(f"/{score}")]
        charts.append(_chart(f"Validation by mode: {score.replace('_', ' ')}", log, columns))
    for title, start in GROUPS.items():
        columns = [name for name in log.columns if name.startswith(start)]
        charts += [_chart(title, log, columns)]
    shown = [chart for chart in charts if chart.lines]
    return [Section("Training", shown)] if shown else []


def _chart(title: str, log: pd.DataFrame, columns: Sequence[str]) -> Chart:
    known = [name for name in columns if name in log and log[name].notna().any()]
    lines = {
        name: (log["epoch"][log[name].notna()].tolist(), log[name].dropna().tolist())
        for name in known
    }
    return Chart(title, "epoch", "", lines, marks=True)
