"""Agreement of lean laws with measured lean on recordings that took no part in their choice.

    python benchmarks/lean_laws.py two_wheeler CACHE bicycle scooter motorcycle     # cache with smoother=zero_phase
    python benchmarks/lean_laws.py autobike CACHE autobike --figure lean.png        # the same; the figure where it is wanted

Each law is driven by the lateral acceleration of the recorded track. Its numbers are chosen on a grid by the correlation with
the measured lean of all other recordings (of two_wheeler: the rides of the other vehicles), then one recording is looked at.
The prescribed pendulum depends on two numbers only, its damping rate and its natural frequency: the grid goes far beyond any
vehicle's range, to tell whether any parameters can be right. Rows of rates compare the rate of lean with the roll gyro.
The figure shows the longest track of every group, each law with the numbers chosen on the others.
"""

import argparse
import itertools

import torch

from diffstack_mmv.data import ConvertedCache, read_leans, read_sensors, read_tracks
from diffstack_mmv.dynamics.gm3 import CoordinatedLean
from diffstack_mmv.dynamics.gm3.lean import Lean, Pendulum, lean_after
from diffstack_mmv.vehicles import load_vehicle

GRAVITY, DT_S = 9.81, 0.1
LAGS = range(-5, 13)
FREQUENCIES = (1.0, 2.0, 3.0, 3.5, 4.0, 6.0, 8.0, 12.0, 20.0)  # rad/s
DAMPINGS = (0.0, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0)  # share of critical damping
ANTICIPATIONS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3)  # s


def prescribed(spec):
    """The pendulum of a vehicle with its own parameters: frequency and share of critical damping."""
    inertia, damping = (
        spec.parameters[name].entries()[0][0] for name in ("roll_inertia", "roll_damping")
    )
    frequency = (spec.mass_kg * spec.height_m * GRAVITY / inertia) ** 0.5
    return frequency, damping / inertia / (2 * frequency)


def pendulum(frequency, share):
    """The prescribed equation, whatever body it belongs to; it anticipates nothing."""
    square = torch.tensor(float(frequency**2))
    return Pendulum(square / GRAVITY, square, torch.tensor(2 * share * frequency)), 0.0


def coordinated(anticipation, bandwidth):
    """The lean of a steady turn with the rider's anticipation."""
    law = CoordinatedLean(anticipation, bandwidth)
    square = torch.tensor(bandwidth**2)
    return Pendulum(square / GRAVITY, square, torch.tensor(2.0 * bandwidth)), law.lead_s


def responses(laws, lateral):
    """Lean (laws, T) of every law that follows a lateral acceleration, from that of a steady turn."""
    columns = [torch.stack(values) for values in zip(*(law for law, _ in laws), strict=True)]
    equation, lead_s = Pendulum(*columns), torch.tensor([lead for _, lead in laws])
    start = torch.atan(lateral[0] / GRAVITY).repeat(len(laws))
    lean = Lean(start, torch.zeros_like(start))
    found = [lean.angle]
    for before, after in zip(lateral[:-1], lateral[1:], strict=True):
        push = 0.5 * (before + after) + lead_s * (after - before) / DT_S
        lean = lean_after(lean, push, equation.secant(lean.angle), DT_S)
        found.append(lean.angle)
    return torch.stack(found, -1)


def correlation(pairs, lag=0):
    """Of model and measurement over all tracks of a recording, the model moved back by a lag."""
    model = torch.cat([a[max(lag, 0) : len(a) + min(lag, 0)] for a, _ in pairs])
    other = torch.cat([b[max(-lag, 0) : len(b) - max(lag, 0)] for _, b in pairs])
    known = model.isfinite() & other.isfinite()
    return float(torch.corrcoef(torch.stack([model[known], other[known]]))[0, 1])


def rides(name, cache, vehicle, rates):
    """(group, lateral acceleration, measured) of every track that has both."""
    spec = load_vehicle(vehicle)
    place = (ConvertedCache(name, cache), ["train", "val", "test"], spec.mode)
    tracks = read_tracks(*place)
    measured = read_sensors(*place, ["roll_rate"]) if rates else read_leans(*place)
    for track, motion in tracks.items():
        moving = motion.velocity[:, 0] > 1.5
        if track not in measured or moving.sum() < 20:
            continue
        first, last = int(moving.nonzero()[0]), int(moving.nonzero()[-1]) + 1
        part = slice(first, last)
        lateral = (motion.velocity[:, 0] * motion.yaw_rate)[part].clamp(-12, 12)
        values = measured[track].double()[part]
        values = values.squeeze(-1) if values.dim() > 1 else values
        group = vehicle if name == "two_wheeler" else track.split("/")[0].rpartition("_")[0]
        yield group, lateral, -values if rates else values


def table(rows, rates, own, fastest):
    """Correlation and lag per law and group, its numbers chosen on the other groups.

    No body is faster than `fastest`, (g / h)^½ in rad/s: its inertia about the ground is at least m h².
    """
    laws = {
        "prescribed": {n: pendulum(*n) for n in itertools.product(FREQUENCIES, DAMPINGS)},
        "coordinated": {n: coordinated(*n) for n in itertools.product(ANTICIPATIONS, FREQUENCIES)},
    }
    groups = sorted({group for group, *_ in rows})
    shown = {group: {} for group in groups}
    for law, candidates in laws.items():
        added = {n: pendulum(*n) for n in own.values()} if law == "prescribed" else {}
        known = candidates | added
        pairs = {numbers: {group: [] for group in groups} for numbers in known}
        for group, lateral, measured in rows:
            leans = responses(list(known.values()), lateral)
            models = torch.gradient(leans, spacing=DT_S, dim=-1)[0] if rates else leans
            for numbers, model in zip(known, models, strict=True):
                pairs[numbers][group].append((model, measured))
        each = {
            numbers: {g: correlation(pairs[numbers][g]) for g in groups} for numbers in candidates
        }
        for group in groups:
            if law == "prescribed" and group in own:
                tell("prescribed, own numbers", group, own[group], pairs[own[group]][group])
                shown[group]["prescribed, own numbers"] = pairs[own[group]][group]
            others = [g for g in groups if g != group]
            if others:
                best = max(candidates, key=lambda n: sum(each[n][g] for g in others))
                tell(f"{law}, chosen on others", group, best, pairs[best][group])
                shown[group][f"{law}, chosen on others"] = pairs[best][group]
            if law == "prescribed" and group in own:
                slow = {n: score for n, score in each.items() if n[0] <= fastest}
                top = max(slow, key=lambda n: slow[n][group])
                tell("prescribed, best of any body", group, top, pairs[top][group])
                shown[group]["prescribed, best of any body"] = pairs[top][group]
            top = max(candidates, key=lambda n: each[n][group])
            tell(f"{law}, best there is", group, top, pairs[top][group])
    return shown


def draw(shown, path):
    """Measured lean and the laws over the longest track of every group."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(len(shown), 1, figsize=(10, 2.6 * len(shown)), squeeze=False)
    for axis, (group, laws) in zip(axes.flat, shown.items(), strict=True):
        sizes = [len(measured) for _, measured in next(iter(laws.values()))]
        longest = sizes.index(max(sizes))
        measured = next(iter(laws.values()))[longest][1]
        time_s = DT_S * torch.arange(len(measured))
        axis.plot(time_s, measured, "k", linewidth=2, label="measured")
        for law, pairs in laws.items():
            axis.plot(time_s, pairs[longest][0], linewidth=1, label=law)
        axis.set(title=group, ylabel="lean [rad]")
    axes.flat[-1].set_xlabel("time [s]")
    axes.flat[0].legend(fontsize="small", ncols=3)
    figure.tight_layout()
    figure.savefig(path, dpi=120)


def tell(law, group, numbers, pairs):
    """One row."""
    found = {lag: correlation(pairs, lag) for lag in LAGS}
    best = max(found, key=found.get)
    text = f"{found[0]:.2f} | {found[best]:.2f} at {DT_S * best:+.1f} s"
    print(f"| {group} | {law} | {tuple(round(n, 2) for n in numbers)} | {text} |", flush=True)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("name")
    parser.add_argument("cache")
    parser.add_argument("vehicles", nargs="+")
    parser.add_argument("--figure")
    options = parser.parse_args()
    print("| recording | law | its numbers | correlation | best, where the model is late by |")
    print("|---|---|---|---|---|")
    own = {vehicle: prescribed(load_vehicle(vehicle)) for vehicle in options.vehicles}
    for rates in (False, True) if options.name == "autobike" else (False,):
        rows = [
            row
            for vehicle in options.vehicles
            for row in rides(options.name, options.cache, vehicle, rates)
        ]
        if options.name == "autobike":  # one vehicle, and a group per session
            (numbers,) = set(own.values())
            own = dict.fromkeys({row[0] for row in rows}, numbers)
        print(f"| **{'rate of lean, roll gyro' if rates else 'lean'}** | | | | |")
        heights = [load_vehicle(vehicle).height_m for vehicle in options.vehicles]
        shown = table(rows, rates, own, (GRAVITY / min(heights)) ** 0.5)
        if options.figure and not rates:
            draw(shown, options.figure)


if __name__ == "__main__":
    main()
