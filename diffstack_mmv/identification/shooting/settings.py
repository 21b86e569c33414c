"""Noise and regularisation of the tracking problem."""

from dataclasses import dataclass

from diffstack_mmv.checks import require_positive, require_switch


@dataclass(frozen=True)
class TrackingSettings:
    """Noise and regularisation of the tracking problem.

    Args:
        along_m: Standard deviation of recorded positions along the motion.
        across_m: Standard deviation across.
        jerk_mps3: Standard deviation of the rate of the acceleration.
        curvature_rate: Standard deviation of the rate of the curvature, 1/(m s).
        steer_rate_radps: Standard deviation of the steering rate, or None for free
            steering. It informs the wheelbase, whose estimate scales with it.
        control_noise: Standard deviation of each measured control, where controls were recorded.
        start_position_m: Standard deviation of the initial position from the recorded one.
        start_course_rad: The same for the initial course.
        start_speed_mps: The same for the initial speed.
        segment_steps: Largest number of steps of a shooting interval; None for single shooting.
        own_steps: Whether measured controls are those of the model's own steps, as in a simulation
            with it; else they moved a vehicle in continuous time. Only a model that acts a step
            late tells the two apart.

    Raises:
        ValueError: A number is not positive, or `own_steps` neither true nor false.
    """

    along_m: float = 0.08
    across_m: float = 0.06
    jerk_mps3: float = 3.0
    curvature_rate: float = 0.5
    steer_rate_radps: float | None = None
    control_noise: tuple[float, ...] | None = None
    start_position_m: float = 0.5
    start_course_rad: float = 0.5
    start_speed_mps: float = 1.0
    segment_steps: int | None = 5
    own_steps: bool = False

    def __post_init__(self) -> None:
        numbers = dict(vars(self))
        require_switch("own_steps", numbers.pop("own_steps"))
        for name, value in numbers.items():
            for number in value if isinstance(value, tuple) else (value,):
                if number is not None:
                    require_positive(name, number)
