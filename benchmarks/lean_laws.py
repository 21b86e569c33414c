"""Agreement of lean laws with measured lean: correlation, and at which lag it is best.

    python benchmarks/lean_laws.py two_wheeler CACHE bicycle      # smoother=zero_phase: a causal one delays the turn itself

The laws are driven by the lateral acceleration of the recorded track; no number is fitted.
"""

import argparse

import torch

from diffstack_mmv.data import ConvertedCache, read_leans, read_tracks
from diffstack_mmv.dynamics.gm3 import CoordinatedLean, PrescribedLean
from diffstack_mmv.dynamics.gm3.lean import Lean, RollBody, lean_after
from diffstack_mmv.vehicles import load_vehicle

LAWS = (PrescribedLean(), CoordinatedLean(0.0), CoordinatedLean(), CoordinatedLean(0.2))
LAGS = range(-5, 13)


def response(law, spec, lateral, dt_s):
    """Lean that follows a lateral acceleration, from the lean of a steady turn."""
    inertia, damping = (
        torch.tensor(spec.parameters[name].entries()[0][0])
        for name in ("roll_inertia", "roll_damping")
    )
    pendulum = law.pendulum(RollBody(spec.mass_kg * spec.height_m, inertia, damping))
    lean = Lean(torch.atan(lateral[:1] / 9.81), torch.zeros_like(lateral[:1]))
    found = [lean.angle]
    for before, after in zip(lateral[:-1], lateral[1:], strict=True):
        push = 0.5 * (before + after) + law.lead_s * (after - before) / dt_s
        lean = lean_after(lean, push.reshape(1), pendulum.secant(lean.angle), dt_s)
        found.append(lean.angle)
    return torch.cat(found)


def correlation(pairs, lag):
    model = torch.cat([a[max(lag, 0) : len(a) + min(lag, 0)] for a, _ in pairs])
    other = torch.cat([b[max(-lag, 0) : len(b) - max(lag, 0)] for _, b in pairs])
    known = model.isfinite() & other.isfinite()
    return float(torch.corrcoef(torch.stack([model[known], other[known]]))[0, 1])


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    for name in ("name", "cache", "vehicle"):
        parser.add_argument(name)
    options = parser.parse_args()
    spec = load_vehicle(options.vehicle)
    place = (ConvertedCache(options.name, options.cache), ["train", "val", "test"], spec.mode)
    tracks, leans = read_tracks(*place), read_leans(*place)
    for law in LAWS:
        pairs = [
            (response(law, spec, motion.velocity[:, 0] * motion.yaw_rate, 0.1), leans[name])
            for name, motion in tracks.items()
            if name in leans
        ]
        found = {lag: correlation(pairs, lag) for lag in LAGS}
        best = max(found, key=found.get)
        text = f"{found[0]:.2f}, best {found[best]:.2f} where the model is {0.1 * best:+.1f} s late"
        print(f"{law}: {text}")


if __name__ == "__main__":
    main()
