"""Differentiable dynamics for autonomous micro-mobility navigation: prediction, planning and control in PyTorch."""

__version__ = "0.1.0"
