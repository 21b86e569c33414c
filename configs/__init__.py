"""Hydra configuration groups; a package, so that an installed project finds its folder."""
