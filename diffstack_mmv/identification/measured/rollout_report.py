"""Roll-outs of all models and baselines by group of windows, and paired tests between them."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from diffstack_mmv.identification.measured.rides import RideWindows
from diffstack_mmv.identification.measured.stages import HeldOut
from diffstack_mmv.identification.measured.study import MeasuredStudyResult
from diffstack_mmv.identification.measured.validation import (
    RolloutErrors,
    paired_by_recording,
    session_of,
)
from diffstack_mmv.types import GRAVITY

SPEEDS = (0.0, 2.8, 3.0, 3.2, 99.0)
"""Edges of the classes of mean speed, m/s."""
LATERAL = (0.0, 0.2, 0.6, 1.0, 99.0)
"""Edges of the classes of mean lateral acceleration, m/s²."""
GYRO = "gyro, speed scaled"
"""Baseline that the identified model is tested against."""


def rollout_table(result: MeasuredStudyResult) -> dict[str, dict[str, dict[str, float]]]:
    """ADE and FDE (m) of all models and baselines, by session, speed and lateral acceleration.

    A line that judged no window of a group is no part of it: with a single session none can be left
    out.
    """
    lines = dict(result.baselines)
    for name, found in result.models.items():
        for left_out, errors in (("recording", found.by_recording), ("session", found.by_session)):
            for how, each in _ways(errors, result.rollouts).items():
                lines[f"{name}, {left_out} left out{how}"] = each
    groups = rollout_groups(result.rollouts)
    return {
        group: {"n": {"windows": float(chosen.sum())}}
        | {name: mean for name, mean in _means(lines, chosen).items() if _is_known(mean)}
        for group, chosen in groups.items()
        if bool(chosen.any())
    }


def _ways(errors: HeldOut, windows: RideWindows) -> dict[str, RolloutErrors]:
    """Errors by how the state was estimated: where no ride has a gyro, not with one."""
    ways = {"": errors.plain}
    if bool(windows.yaw_rate.isfinite().any()):
        ways[", with gyro"] = errors.with_gyro
    return ways


def _means(lines: Mapping[str, RolloutErrors], chosen: Tensor) -> dict[str, dict[str, float]]:
    return {name: errors.mean(chosen) for name, errors in lines.items()}


def _is_known(mean: Mapping[str, float]) -> bool:
    return all(math.isfinite(value) for value in mean.values())


def rollout_groups(windows: RideWindows) -> dict[str, Tensor]:
    """Masks, each of shape (w,): all windows, sessions, classes of speed and lateral acceleration.

    A window belongs to the classes of its mean speed in m/s and its mean acceleration in m/s².
    A session or class of all windows is none of its own: it would repeat their rows.
    """
    speed = windows.speed.mean(-1)
    lateral = (windows.speed[:, :-1] * windows.yaw_rate).abs().nanmean(-1).clamp(max=GRAVITY)
    sessions = [session_of(windows.names[int(index)]) for index in windows.recording]
    groups = {"all": torch.ones_like(speed, dtype=torch.bool)}
    for session in sorted(set(sessions)):
        groups[f"session {session}"] = torch.tensor([each == session for each in sessions])
    for text, values, edges in (
        ("speed {:g}-{:g} m/s", speed, SPEEDS),
        ("lateral {:g}-{:g} m/s2", lateral, LATERAL),
    ):
        for low, high in zip(edges[:-1], edges[1:], strict=True):
            groups[text.format(low, high)] = (values >= low) & (values < high)
    return {name: each for name, each in groups.items() if name == "all" or not bool(each.all())}


def rollout_tests(identified: str, result: MeasuredStudyResult) -> dict[str, dict[str, float]]:
    """Every model against the identified one, and that against the gyro.

    Over all roll-outs by recording and by session, and by recording within the classes of speed
    and lateral acceleration.
    """
    own, gyro = result.models[identified], result.baselines[GYRO]
    lines: dict[str, tuple[Tensor, Tensor]] = {}
    for left_out in ("recording", "session"):
        first = _ways(getattr(own, f"by_{left_out}"), result.rollouts)
        lines[f"{identified} - {GYRO}, {left_out} left out"] = first[""].ade, gyro.ade
        for name, found in result.models.items():
            if name == identified:
                continue
            second = _ways(getattr(found, f"by_{left_out}"), result.rollouts)
            for how, one in first.items():
                text = f"{name} - {identified}, {left_out} left out{how}"
                lines[text] = second[how].ade, one.ade
    groups = rollout_groups(result.rollouts)
    return {
        f"{text}; {group}": test
        for text, (first, second) in lines.items()
        for group, test in _paired(first, second, result.rollouts, groups).items()
    }


def _paired(
    first: Tensor, second: Tensor, windows: RideWindows, groups: Mapping[str, Tensor]
) -> dict[str, dict[str, float]]:
    """Paired tests by group; those of a single recording or session would tell nothing."""
    known = first.isfinite() & second.isfinite()
    sessions = [session_of(name) for name in windows.names]
    number = torch.tensor([sessions.index(each) for each in sessions])
    owners = {"by recording": windows.recording, "by session": number[windows.recording]}
    jobs = [("all", "by recording"), ("all", "by session")]
    jobs += [(group, "by recording") for group in groups if group != "all"]
    found = {}
    for group, unit in jobs:
        chosen = groups[group] & known
        owner = owners[unit][chosen]
        if len(owner.unique()) > 1:
            test = paired_by_recording(first[chosen], second[chosen], owner)
            found[f"{group}, {unit}"] = test._asdict()
    return found
