"""Recordings made by hand: people who walk back and forth along x, at many y."""

from dataclasses import dataclass

import pytest
import torch

from diffstack_mmv.simulation import RecordedCrossing
from diffstack_mmv.types import Mode, Motion, RecordedScene, Tracks

STEP_S = 0.1


def recorded(position, valid=None, step_s=STEP_S):
    """A scene of pedestrians of (people, rows, 2) positions in m."""
    people, rows = position.shape[:2]
    flat = torch.zeros(people, rows, dtype=torch.float64)
    motion = Motion(position, flat, torch.zeros_like(position), flat)
    extent = torch.tensor([[0.5, 0.6]], dtype=torch.float64).expand(people, 2)
    mode = torch.full((people,), int(Mode.PEDESTRIAN))
    valid = torch.ones(people, rows, dtype=torch.bool) if valid is None else valid
    return RecordedScene(Tracks(motion, extent, mode, valid), step_s)


def stream(rows=301, people=24, seed=0):
    """People on lanes along x who start one after the other, and leave after 12 s."""
    generator = torch.Generator().manual_seed(seed)
    time = STEP_S * torch.arange(rows, dtype=torch.float64)
    begin = 18 * torch.rand(people, 1, generator=generator, dtype=torch.float64)
    lane = 6 * torch.rand(people, 1, generator=generator, dtype=torch.float64)
    speed = 1 + 0.5 * torch.rand(people, 1, generator=generator, dtype=torch.float64)
    speed = speed * (1 - 2 * (torch.arange(people)[:, None] % 2))
    x = 100 + speed * (time - begin - 6)
    y = -50 + lane + 0.2 * (time - begin).sin()
    valid = (time >= begin) & (time <= begin + 12)
    return recorded(torch.stack((x, y), -1), valid)


@dataclass(frozen=True)
class Reader:
    """Scenes by split and name."""

    scenes: dict

    def duration_s(self, split):
        return {
            name: (scene.tracks.valid.shape[1] - 1) * scene.dt_s
            for name, scene in self.scenes[split].items()
        }

    def read(self, name):
        return next(each[name] for each in self.scenes.values() if name in each)


@pytest.fixture(scope="session")
def reader():
    return Reader({"train": {"one": stream()}, "test": {"two": stream(seed=1)}})


@pytest.fixture
def crossing(reader):
    """Cases of the stream, with overrides."""

    def build(**settings):
        given = {
            "history_s": 2.0,
            "limit_s": 8.0,
            "met": 1,
            "entry_m": 1.0,
            "blind_mps": 0.0,
            "humans": 12,
        } | settings
        return RecordedCrossing(reader, **given)

    return build
