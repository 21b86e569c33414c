"""Folder names of the TH-AB VRU tracks and the modes they hold."""

from __future__ import annotations

from dmmv_conventions.modes import Mode

FOLDER_MODES = {"cyclists": Mode.BICYCLE, "pedestrians": Mode.PEDESTRIAN}
PHASES = ("moving", "starting", "stopping", "waiting")
