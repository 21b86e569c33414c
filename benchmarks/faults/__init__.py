"""Faults of every kind, tried one by one: `python -m benchmarks.faults`."""
