"""Solvers in C++ for one kind of problem, generated from its callables."""

from diffstack_mmv.control.native.solver import Numbers, solve

__all__ = ["Numbers", "solve"]
