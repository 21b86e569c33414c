"""CrowdNav from Python: a vehicle that a controller drives through a crowd, with no command line.

The settings are those of `scripts/navigate.py`, read from the same files, so the episodes are the
same too.
"""

from diffstack_mmv.crowdnav.drive import LIMITS, CrowdNav

__all__ = ["LIMITS", "CrowdNav"]
