"""The conversion report: what was read, kept and rejected, and how much smoothing took away."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from data_converters.heading import HeadingSource
from data_converters.recordings import RawScene, Rejection
from data_converters.tracks import AgentRows, Residual
from dmmv_conventions.modes import Mode

WINDOW_STEPS_S = (4.0, 3.0)


@dataclass
class SceneReport:
    """Counts of one scene; plain values, so that it survives a trip through JSON.

    `residual` holds the sums of `Residual` per mode; older reports lack the last two. `windows`
    counts per mode the time steps with 4 s of history and 3 s of future. `fastest_mps` is the
    largest smoothed speed; older reports lack it. `sampling` holds the `Sampling` of each agent.
    """

    name: str
    split: str
    key: str
    steps: int = 0
    tracks_read: int = 0
    agents: dict[str, int] = field(default_factory=dict)
    windows: dict[str, int] = field(default_factory=dict)
    rows: int = 0
    interpolated_rows: int = 0
    heading_rows: dict[str, int] = field(default_factory=dict)
    residual: dict[str, list[float]] = field(default_factory=dict)
    speed_errors_mps: list[float] = field(default_factory=list)
    rejected: list[dict[str, str]] = field(default_factory=list)
    notes: dict[str, int] = field(default_factory=dict)
    fastest_mps: float | None = None
    sampling: dict[str, list[float]] = field(default_factory=dict)

    @property
    def usable(self) -> bool:
        """Whether the scene holds an agent."""
        return bool(self.agents)

    @property
    def current(self) -> bool:
        """Whether it has all that a present one has.

        An earlier report calls a car a vehicle, or does not tell when its agents were sampled.
        """
        named = set(self.agents) <= {mode.label for mode in Mode}
        return named and len(self.sampling) == sum(self.agents.values())


def report_scene(
    name: str, split: str, key: str, raw: RawScene, agents: Sequence[AgentRows], dt_s: float
) -> SceneReport:
    """Count one scene.

    Args:
        name: Name of the scene.
        split: Its split.
        key: Hash of everything it was made from.
        raw: The scene as read, with all rejections.
        agents: What was kept, rows every `dt_s`.
        dt_s: Step in s.

    Returns:
        The counts.
    """
    report = SceneReport(name, split, key, tracks_read=len(raw.tracks) + _refused(raw))
    report.notes = dict(raw.notes)
    report.rejected = [_plain(item) for item in raw.rejected]
    window_steps = round(sum(WINDOW_STEPS_S) / dt_s)
    for agent in agents:
        mode = agent.mode.label
        _add(report.agents, mode, 1)
        _add(report.windows, mode, max(0, len(agent.rows) - window_steps))
        _count_rows(report, agent)
        _add_residual(report.residual, mode, agent.residual)
        report.sampling[agent.name] = list(agent.sampling)
        if np.isfinite(agent.speed_error):
            report.speed_errors_mps.append(round(agent.speed_error, 4))
        report.steps = max(report.steps, agent.first_step + len(agent.rows))
        fastest = float(np.hypot(agent.rows["vx"], agent.rows["vy"]).max())
        report.fastest_mps = max(report.fastest_mps or 0.0, round(fastest, 6))
    return report


def _refused(raw: RawScene) -> int:
    return len({item.track for item in raw.rejected} - {track.name for track in raw.tracks})


def _plain(item: Rejection) -> dict[str, str]:
    return {**item._asdict(), "reason": item.reason.value}


def _count_rows(report: SceneReport, agent: AgentRows) -> None:
    report.rows += len(agent.rows)
    report.interpolated_rows += int(agent.rows["interpolated"].sum())
    for source in HeadingSource:
        count = int((agent.rows["heading_source"] == source).sum())
        _add(report.heading_rows, source.name.lower(), count)


def _add(counts: dict[str, int], name: str, count: int) -> None:
    counts[name] = counts.get(name, 0) + count


def _add_residual(sums: dict[str, list[float]], mode: str, residual: Residual) -> None:
    before = sums.get(mode, [0.0] * len(residual))
    sums[mode] = [a + b for a, b in zip(before, residual, strict=True)]


def _whole(values: Sequence[float]) -> Residual:
    """The sums of a scene; NaN for what an older report lacks."""
    known = [*values, *[float("nan")] * (len(Residual._fields) - len(values))]
    return Residual(int(known[0]), *known[1:])


def _noise(sums: Residual) -> dict[str, float]:
    """Standard deviations of one recorded position in m and the usual step in s, where known."""
    if not sums.white > 0.0:
        return {}
    return {
        "noise_along_m": (sums.along / sums.white) ** 0.5,
        "noise_across_m": (sums.across / sums.white) ** 0.5,
        "step_s": sums.seconds / sums.count,
    }


@dataclass
class ConversionReport:
    """The report of a whole conversion; `as_dict` is what `conversion_report.json` holds."""

    dataset: str
    settings: dict[str, Any]
    settings_hash: str
    versions: dict[str, str]
    scenes: list[SceneReport]
    dataset_notes: dict[str, Any] = field(default_factory=dict)

    @property
    def rejected_by_reason(self) -> dict[str, int]:
        """Number of rejected tracks (or stretches of tracks) per reason."""
        reasons = Counter(item["reason"] for scene in self.scenes for item in scene.rejected)
        return dict(sorted(reasons.items()))

    @property
    def residual_m(self) -> dict[str, dict[str, float]]:
        """Per mode: root mean square residual of the noise smoother, and the noise it tells of.

        Number of moving samples; residual along and across the motion in m; standard deviation of
        one recorded position in m, corrected for the share that the smoother takes up; usual step
        in s.
        """
        sums: dict[str, list[float]] = {}
        for scene in self.scenes:
            for mode, values in scene.residual.items():
                _add_residual(sums, mode, _whole(values))
        return {
            mode: {
                "samples": values[0],
                "along_m": (values[1] / values[0]) ** 0.5,
                "across_m": (values[2] / values[0]) ** 0.5,
                **_noise(_whole(values)),
            }
            for mode, values in sorted(sums.items())
            if values[0] > 0
        }

    def windows(self) -> dict[str, dict[str, int]]:
        """Time steps with 4 s of history and 3 s of future, per split and mode."""
        return _per_split((scene.split, scene.windows) for scene in self.scenes)

    def agents(self) -> dict[str, dict[str, int]]:
        """Agents (gap-free stretches) per split and mode."""
        return _per_split((scene.split, scene.agents) for scene in self.scenes)

    def totals(self) -> dict[str, Any]:
        """Sums over all scenes."""
        errors = [error for scene in self.scenes for error in scene.speed_errors_mps]
        return {
            "scenes": sum(scene.usable for scene in self.scenes),
            "scenes_without_agents": sum(not scene.usable for scene in self.scenes),
            "tracks_read": sum(scene.tracks_read for scene in self.scenes),
            "rows": sum(scene.rows for scene in self.scenes),
            "interpolated_rows": sum(scene.interpolated_rows for scene in self.scenes),
            "heading_rows": _summed(scene.heading_rows for scene in self.scenes),
            "notes": _summed(scene.notes for scene in self.scenes),
            "median_speed_error_mps": float(np.median(errors)) if errors else None,
            "agents": self.agents(),
            "windows_4s_3s": self.windows(),
            "rejected": self.rejected_by_reason,
            "smoother_residual": self.residual_m,
        }

    def as_dict(self) -> dict[str, Any]:
        """Everything as plain values."""
        return {
            "dataset": self.dataset,
            "settings": self.settings,
            "settings_hash": self.settings_hash,
            "versions": self.versions,
            "dataset_notes": self.dataset_notes,
            "totals": self.totals(),
            "scenes": [asdict(scene) for scene in self.scenes],
        }


def _summed(counts: Iterable[dict[str, int]]) -> dict[str, int]:
    total: Counter[str] = Counter()
    for part in counts:
        total.update(part)
    return dict(total)


def _per_split(counts: Iterable[tuple[str, dict[str, int]]]) -> dict[str, dict[str, int]]:
    total: dict[str, Counter[str]] = {}
    for split, part in counts:
        total.setdefault(split, Counter()).update(part)
    return {split: dict(sorted(part.items())) for split, part in sorted(total.items())}
