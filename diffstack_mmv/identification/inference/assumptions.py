"""Assumed noise and rider of the tracking problem: as given, else as the recordings tell."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from diffstack_mmv.checks import require, require_positive
from diffstack_mmv.identification.inference.rider_scales import estimate_rider_scales
from diffstack_mmv.identification.shooting.settings import TrackingSettings
from diffstack_mmv.identification.tracks.cutting import Recordings
from diffstack_mmv.identification.tracks.segments import TrackSegment
from diffstack_mmv.vehicles import VehicleSpec

FREE_OF_NOISE_M = 1e-6
"""Noise of positions up to which they were made up, or not smoothed: it is no scale of a fit."""


@dataclass(frozen=True)
class TrackingAssumptions:
    """What `TrackingSettings` are made of; None stands for what the recordings tell.

    Args:
        along_m: Standard deviation of recorded positions along the motion.
        across_m: Standard deviation across.
        jerk_mps3: Standard deviation of the rate of the rider's acceleration.
        curvature_rate: Standard deviation of the rate of the rider's curvature, 1/(m s).
        segment_steps: Largest number of steps of a shooting interval; None for single shooting.
        steer_rate_radps: Standard deviation of the steering rate; None for free steering.
        controls: Standard deviation of each recorded control by its name, in the order of the
            model's controls; None if recorded controls are not used.
        start_position_m: Standard deviation of the initial position.
        start_course_rad: Standard deviation of the initial course.
        start_speed_mps: Standard deviation of the initial speed.

    Raises:
        ValueError: A number is not positive.
    """

    along_m: float | None = None
    across_m: float | None = None
    jerk_mps3: float | None = None
    curvature_rate: float | None = None
    segment_steps: int | None = 5
    steer_rate_radps: float | None = None
    controls: Mapping[str, float] | None = None
    start_position_m: float = TrackingSettings.start_position_m
    start_course_rad: float = TrackingSettings.start_course_rad
    start_speed_mps: float = TrackingSettings.start_speed_mps

    def __post_init__(self) -> None:
        for name in (
            *("along_m", "across_m", "jerk_mps3", "curvature_rate", "segment_steps"),
            *("steer_rate_radps", "start_position_m", "start_course_rad", "start_speed_mps"),
        ):
            if getattr(self, name) is not None:
                require_positive(name, getattr(self, name))
        for name, noise in (self.controls or {}).items():
            require_positive(f"controls.{name}", noise)

    def settings(
        self,
        recordings: Recordings,
        spec: VehicleSpec,
        segments: Sequence[TrackSegment],
        dt_s: float,
    ) -> TrackingSettings:
        """Fill in what the recordings tell.

        Args:
            recordings: Their noise is that of positions where none is given.
            spec: The vehicle.
            segments: The segments to fit, from which the rider's rates are estimated.
            dt_s: Step of the tracks.

        Raises:
            ValueError: A number is not positive, or neither given nor told by the recordings.
        """
        defaults = TrackingSettings()
        noise = recordings.noise_m or (defaults.along_m, defaults.across_m)
        settings = TrackingSettings(
            along_m=_noise("along_m", self.along_m, noise[0]),
            across_m=_noise("across_m", self.across_m, noise[1]),
            jerk_mps3=_given(self.jerk_mps3, defaults.jerk_mps3),
            curvature_rate=_given(self.curvature_rate, defaults.curvature_rate),
            steer_rate_radps=self.steer_rate_radps,
            control_noise=tuple(self.controls.values()) if self.controls else None,
            start_position_m=self.start_position_m,
            start_course_rad=self.start_course_rad,
            start_speed_mps=self.start_speed_mps,
            segment_steps=self.segment_steps,
        )
        if self.jerk_mps3 is not None and self.curvature_rate is not None:
            return settings
        smoothed = recordings.smoothed
        estimated = estimate_rider_scales(settings, spec, segments, dt_s, smoothed)
        return replace(
            estimated,
            jerk_mps3=_given(self.jerk_mps3, estimated.jerk_mps3),
            curvature_rate=_given(self.curvature_rate, estimated.curvature_rate),
        )


def _given(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value


def _noise(name: str, given: float | None, told: float) -> float:
    """Noise of positions; recordings without a residual, as those not smoothed, tell none."""
    needs, remedy = "be given where the recordings tell no noise", f"Set noise.{name}, in m."
    require(given is not None or told > FREE_OF_NOISE_M, f"noise.{name}", needs, told, "", remedy)
    return _given(given, told)
