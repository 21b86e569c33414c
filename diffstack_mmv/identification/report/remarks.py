"""What an identification says and does not say, in sentences."""

from collections.abc import Mapping

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.identification.inference.excitation import Excitation
from diffstack_mmv.identification.inference.identifier import Identification
from diffstack_mmv.identification.inference.optima import posterior_shares
from diffstack_mmv.identification.inference.sensitivity import Identifiability, describe_direction
from diffstack_mmv.identification.shooting.linearisation import TrackSimulator
from diffstack_mmv.identification.shooting.parameters import ParameterVector
from diffstack_mmv.identification.shooting.settings import TrackingSettings
from diffstack_mmv.identification.tracks.cutting import UNSMOOTHED

NEAR_THE_LIMIT = 0.6  # of the adhesion limit: above, friction shapes the path
MISFIT = 1.25  # residuals over assumed noise
LARGE_INFLUENCE = 0.5  # prior deviations
AT_THE_EDGE = 0.01  # of the range
NOTEWORTHY = 0.05  # share of the posterior of an optimum that gets a remark
WEAKEST = 3  # directions that get a remark
LAGGING = "CausalSmoother"  # how one begins that tells of a smoother with a lag
ROUNDING = 1e-12  # share of the prior's information below which a number is an error of rounding


def all_remarks(
    simulator: TrackSimulator,
    found: Identification,
    demands: Excitation,
    influence: Mapping[str, Float[Tensor, " p"]],
) -> list[str]:
    """All remarks on an identification.

    Args:
        simulator: Model and residuals.
        found: The identification.
        demands: How hard the tracks work the vehicle.
        influence: Change of the estimates by the doubled deviation of each assumption.
    """
    if not simulator.parameters.names:
        return ["The model has no learnable parameter: the tracks were only tracked."]
    return [
        *unobservable_parameters(simulator, found, demands),
        *information_directions(simulator, found),
        *other_optima(simulator, found),
        *dependence_on_assumptions(simulator, influence),
        *misfit(found),
        *simulated_controls(simulator),
        *estimates_at_the_edge(simulator.parameters, found.after.theta),
    ]


def lagging_alone(smoother: str) -> list[str]:
    """Of positions behind a smoother with a lag from which the controls are inferred."""
    if not smoother.startswith(LAGGING):
        return []
    return [
        f"The positions are smoothed ({smoother}): they come late, and what is left of their noise "
        "counts as motion of the rider, so that controls and parameters are not to be trusted. "
        "Convert with smoother=zero_phase into another cache; an identification may look ahead."
    ]


def smoothed_beside_instruments(smoother: str) -> list[str]:
    """Of smoothed positions beside instruments that are not: nothing undoes what they differ by."""
    if smoother.startswith(UNSMOOTHED):
        return []
    return [
        f"The positions are smoothed ({smoother}), the instruments are not: above all the place of "
        "the antenna is off by more than its deviations say. Convert with smoother=none into "
        "another cache."
    ]


def smoothed_beside_controls(smoother: str) -> list[str]:
    """Of smoothed positions beside recorded controls: what was done, and what it does not mend."""
    if smoother.startswith(UNSMOOTHED):
        return []
    told = (
        "and the recorded controls by the same filter. That leaves their relation as it is where "
        "the vehicle turns little within the window of the smoother; where it turns fast"
    )
    if smoother.startswith(LAGGING):
        told = (
            "and the lag of the smoother was undone, as if samples of a track had come at equal "
            "steps. Where they did not and the vehicle turns fast"
        )
    return [
        f"The positions are smoothed ({smoother}), {told}, estimates are off by more than the "
        "deviations say. Convert with smoother=none, and set `noise` to what this conversion "
        "reports."
    ]


def unobservable_parameters(
    simulator: TrackSimulator, found: Identification, demands: Excitation
) -> list[str]:
    """Parameters that the tracks say nothing about, with the reason."""
    silent = {
        name.split(".")[0]
        for name, verdict in zip(simulator.parameters.names, found.identifiability, strict=True)
        if verdict is Identifiability.NOT_IDENTIFIABLE
    }
    reasons = _reasons(simulator.vehicle.settings, demands)
    usual = "its effect on the paths is lost in noise and free steering"
    return [
        f"{name} is not observable in these tracks: {reasons.get(name, usual)}; "
        "it stays at its prior."
        for name in sorted(silent)
    ]


def _reasons(settings: TrackingSettings, demands: Excitation) -> dict[str, str]:
    """Why a parameter may not be observable, by its name."""
    steering = "steering was not recorded and is free, so every wheelbase gives the same path"
    if settings.control_noise is not None:
        steering = "the recorded controls are too uncertain for it, or the tracks hardly turn"
    elif settings.steer_rate_radps is not None:
        steering = "the steering prior is too wide for it"
    adhesion = (
        f"{100 * demands.adhesion:.0f} % of the adhesion limit μ g, with μ = {demands.friction:.2f}"
    )
    return {
        "friction": f"the tyres are never asked for more than {adhesion}"
        if demands.adhesion < NEAR_THE_LIMIT
        else "a rider whose controls are unknown may simply have asked for less",
        "wheelbase": steering,
        "length_scale": steering,
        "roll_inertia": "lean moves the path by less than the noise",
        "roll_damping": "lean moves the path by less than the noise",
        "yaw_inertia": "the yaw follows the steering faster than the tracks are sampled",
    }


def information_directions(simulator: TrackSimulator, found: Identification) -> list[str]:
    """The least informed directions in the space of the parameters, and the best informed one."""
    names, directions = simulator.parameters.names, found.sensitivity.directions
    weak = [
        f"Weak direction ({_share(each.eigenvalue)} of the prior's information): "
        f"{describe_direction(each, names)}."
        for each in directions[-WEAKEST:]
    ]
    best = directions[0]
    strong = (
        f"Best informed direction ({best.eigenvalue:.3g} times the prior's information): "
        f"{describe_direction(best, names)}."
    )
    return [*weak, strong]


def _share(eigenvalue: float) -> str:
    return f"{eigenvalue:.2g}" if eigenvalue >= ROUNDING else "none"


def other_optima(simulator: TrackSimulator, found: Identification) -> list[str]:
    """Other values that explain the tracks about as well."""
    parameters = simulator.parameters
    best, *others = [parameters.values(each.fit.theta) for each in found.optima]
    shares = posterior_shares(found.optima).tolist()[1:]
    std = found.optima[0].sensitivity.std
    remarks = []
    for share, values in zip(shares, others, strict=True):
        differs = ((values - best).abs() > std).tolist()
        named = zip(parameters.names, values.tolist(), differs, strict=True)
        differing = [f"{name} {value:.3g}" for name, value, apart in named if apart]
        told = ", ".join(differing) or "no value is a deviation away"
        if share >= NOTEWORTHY:
            remarks.append(
                f"Another optimum holds {100 * share:.0f} % of the posterior: "
                f"{told}. The deviations include it."
            )
    return remarks


def dependence_on_assumptions(
    simulator: TrackSimulator, influence: Mapping[str, Float[Tensor, " p"]]
) -> list[str]:
    """Estimates that owe more to assumptions than to tracks."""
    return [
        f"The estimate of {name} depends on the assumed `{setting}`: doubling it would move the "
        f"estimate by {change:+.1f} prior deviations. Do not trust it."
        for setting, changes in influence.items()
        for name, change in zip(simulator.parameters.names, changes.tolist(), strict=True)
        if abs(change) > LARGE_INFLUENCE
    ]


def misfit(found: Identification) -> list[str]:
    """Residuals above the assumed noise."""
    if found.noise_factor <= MISFIT:
        return []
    return [
        f"The residuals are {found.noise_factor:.2f} times the assumed noise: the model does "
        "not explain the tracks, recorded controls are not theirs (left is positive; one clock), "
        "or the fit ended in a poor optimum. Do not trust it."
    ]


def simulated_controls(simulator: TrackSimulator) -> list[str]:
    """Controls that fit as those of the model, not as those of a vehicle."""
    if not simulator.vehicle.settings.own_steps:
        return []
    name = type(simulator.vehicle.model).__name__
    return [
        f"The recorded controls fit best as those of {name}'s own steps, as in a simulation with "
        "it. A vehicle moves half a step earlier: if one was recorded, its clocks differ by that."
    ]


def estimates_at_the_edge(parameters: ParameterVector, theta: Float[Tensor, " p"]) -> list[str]:
    """Estimates of parameters, θ of shape (p,), at the ends of their ranges."""
    values, prior = parameters.values(theta), parameters.prior
    margin = AT_THE_EDGE * (prior.high - prior.low)
    inside = (values >= prior.low + margin) & (values <= prior.high - margin)
    return [
        f"The estimate of {name} lies at the edge of its range: widen the range."
        for name, fine in zip(parameters.names, inside.tolist(), strict=True)
        if not fine
    ]
