"""Draw the figures of docs/dynamics.md: python docs/draw_dynamics.py."""

from pathlib import Path

import torch

from diffstack_mmv.dynamics.gm3.tire import ConsistentBrush, PaperBrush, SharpBrush, Tire
from diffstack_mmv.plotting.figures import PALETTE, new_figure, save_figure

FOLDER = Path(__file__).parent / "figures"
LAWS: dict[str, Tire] = {
    "exact (GM3, odd cubic)": SharpBrush(),
    "smooth, k = 10": PaperBrush(10.0),
    "smooth, k = 50": PaperBrush(50.0),
    "smooth, k = 200": PaperBrush(200.0),
    "smooth, k = 1000": PaperBrush(1000.0),
    "consistent": ConsistentBrush(),
}
LOAD, FRICTION = 504.5, 0.8  # the rear tyre of the bicycle


def _forces(law: Tire, along: float, spin: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Slip angles and lateral force over μ F_z at a longitudinal slip."""
    angle = torch.linspace(-0.5, 0.5, 1001).double()
    parameters = [torch.tensor(value).double() for value in (FRICTION, 1.495e6, 0.045)]
    slips = torch.full_like(angle, along), angle.tan(), angle, torch.full_like(angle, spin)
    _, lateral, _ = law(torch.full_like(angle, LOAD), *slips, *parameters)
    return angle, lateral / (FRICTION * LOAD)


def draw_tire_curves() -> None:
    """Lateral force over slip angle: pure slip, with a braked wheel, with camber."""
    figure = new_figure(11.0, 4.0)
    panels = {"pure lateral slip": (0.0, 0.0), "locked wheel, σ_x = -0.5": (-0.5, 0.0)}
    panels["leaning, φ = 0.9 1/m"] = (0.0, 0.9)
    for column, (title, (along, spin)) in enumerate(panels.items()):
        axes = figure.add_subplot(1, 3, column + 1)
        for index, (name, law) in enumerate(LAWS.items()):
            angle, force = _forces(law, along, spin)
            style = "--" if name.startswith("exact") else "-"
            axes.plot(angle, force, style, color=PALETTE[index], linewidth=1.3, label=name)
        axes.set(title=title, xlabel="slip angle α [rad]", ylim=(-1.35, 1.35))
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("F_y / (μ F_z)")
    figure.axes[0].legend(fontsize=7)
    save_figure(figure, FOLDER / "tire_curves.png")


if __name__ == "__main__":
    draw_tire_curves()
