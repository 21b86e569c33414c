"""Differentiable prediction, planning and control for micro-mobility, in PyTorch."""

__version__ = "0.1.0"
